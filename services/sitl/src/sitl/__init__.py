"""A PX4-like autopilot stand-in: MAVLink 2 in and out, simple flight dynamics between.

Pure modules (`parameters`, `dynamics`, `autopilot`, `telemetry`, `streams`) take messages and time; `process`
has the sockets and the clock.
"""
