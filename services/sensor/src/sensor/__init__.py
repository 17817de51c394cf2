"""A sensor node of the field: its values come from a model, and it publishes them by MQTT-XT."""
