"""The connection to a broker (paho-mqtt); nothing else in `mqttxt` talks to one."""
