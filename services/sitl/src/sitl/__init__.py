"""An autopilot stand-in, like PX4 or ArduCopter: MAVLink 2 in and out, simple flight dynamics between.

Pure modules take messages and time: `vehicle` joins `autopilot` (state), `guidance` (where it wants to go), `commands`
(PX4's rules), `telemetry`, `streams`, `parameters` and `control` (the side channel). `process` has the sockets and the
clock.
"""
