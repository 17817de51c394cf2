"""The embedded broker's address as others reach it."""

from __future__ import annotations

import socket

from mqttxt.core.embedded_broker import EmbeddedBroker


def test_on_one_interface_the_address_is_that_interfaces() -> None:
    assert EmbeddedBroker("192.0.2.7", 1884).url_towards("127.0.0.1", 1883) == "mqtt://192.0.2.7:1884"


def test_on_all_interfaces_it_is_the_one_that_leads_to_the_cloud() -> None:
    broker = EmbeddedBroker("0.0.0.0", 1884)
    assert broker.url == "mqtt://127.0.0.1:1884"
    assert broker.url_towards("127.0.0.1", 1883) == "mqtt://127.0.0.1:1884"


def test_without_a_way_to_the_cloud_it_is_the_machines_name() -> None:
    broker = EmbeddedBroker("0.0.0.0", 1884)
    assert broker.url_towards("cloud.invalid", 1883) == f"mqtt://{socket.gethostname()}:1884"
