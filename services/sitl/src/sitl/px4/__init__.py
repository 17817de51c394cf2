"""The stand-in as PX4: its modes, rules, flight, telemetry, streams and parameters."""
