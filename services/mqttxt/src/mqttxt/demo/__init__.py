"""`mqttxt demo`: brokers, an activator, simulated drones and the page on this machine, each a process of its own.

`parts` starts and ends processes, `ports` finds places for them, `fleet` says which drones fly, `process` joins them.
"""
