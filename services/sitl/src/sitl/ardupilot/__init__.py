"""The stand-in as ArduPilot's ArduCopter: its modes, rules, flight, telemetry, streams and parameters."""
