"""MAVLink at the ground: a fleet's drones as vehicles for QGroundControl, MAVSDK and MAVProxy (docs/gateway.md).

The gateway is a ground station: it uses `GroundStation` as any program does, and none of its internals.
"""
