"""A plain MQTT 5 client on loopback, without MQTT-XT's rules."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion


@contextmanager
def plain_client(
    port: int, *topics: str, heard: Callable[[MQTTMessage], object] = lambda message: None
) -> Iterator[Client]:
    """A client that is connected while this is entered; `heard` gets each message of `topics`."""
    client = Client(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv5)
    client.on_message = lambda _client, _data, message: heard(message)
    client.connect("127.0.0.1", port)
    for topic in topics:
        client.subscribe(topic, qos=1)
    client.loop_start()
    try:
        yield client
    finally:
        client.disconnect()
        client.loop_stop()
