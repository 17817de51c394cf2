"""A sensor node of the field: what it measures comes from a model, how it publishes is MQTT-XT."""
