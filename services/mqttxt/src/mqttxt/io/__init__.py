"""What touches the world: brokers (paho-mqtt), autopilots (pymavlink), processes and files."""
