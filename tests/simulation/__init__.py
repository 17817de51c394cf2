"""The protocol's roles without brokers, autopilots and real time."""
