"""A PX4-like autopilot stand-in: MAVLink 2 in and out, simple flight dynamics between.

Pure modules take messages and time: `vehicle` joins `autopilot` (state), `guidance` (where it wants to go), `commands`
(PX4's rules), `telemetry`, `streams`, `parameters` and `control` (the side channel). `process` has the sockets and the
clock.
"""
