"""The connection to a broker (paho-mqtt)."""
