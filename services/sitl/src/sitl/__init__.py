"""An autopilot stand-in, like PX4 or ArduCopter: MAVLink 2 in and out, simple flight dynamics between.

Pure modules take messages and time: `vehicle` joins `autopilot` (state), `guidance` (where it wants to go),
`telemetry`, `streams`, `parameters` and `control` (the side channel). What differs between autopilots is behind
`personality`; `px4` and `ardupilot` have their modes, rules, flight and messages. `process` has the sockets and the
clock.
"""
