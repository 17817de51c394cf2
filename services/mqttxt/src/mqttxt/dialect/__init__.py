"""The dialect: what MAVLink's messages mean as MQTT-XT's states, and how commands are said in MAVLink."""
