"""`mqttxt demo`: brokers, an activator, simulated drones and the page on this machine, each a process of its own.

`parts` starts and ends processes, `ports` finds their ports, `fleet` has the drones, `process` joins them.
"""
