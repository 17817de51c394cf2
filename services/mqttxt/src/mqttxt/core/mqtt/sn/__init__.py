"""MQTT-SN 1.2 between a UAV client and its activator, over UDP (docs/protocol.md, section 20)."""
