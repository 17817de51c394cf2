"""The embedded broker's address as others reach it."""

from __future__ import annotations

import socket

import pytest

from mqttxt import ConfigurationError
from mqttxt.core.address import BrokerAddress, address_of
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


@pytest.mark.parametrize("host", ["::1", "::"])
def test_an_ipv6_address_stands_in_brackets_and_is_read_again(host: str) -> None:
    broker = EmbeddedBroker(*address_of(f"[{host}]:1884", "--listen"))
    assert broker.host == host
    for url in (broker.url, broker.url_towards("::1", 1883)):
        assert BrokerAddress.parse(url) == BrokerAddress("::1", 1884)
        assert str(BrokerAddress.parse(url)) == url


@pytest.mark.parametrize("text", ["::1:1884", "[127.0.0.1]:1884", "[::1:1884", "[]:1884", "[::1]", ":1884"])
def test_what_is_no_host_and_port_is_refused(text: str) -> None:
    with pytest.raises(ConfigurationError, match=r"--listen .*: expected HOST:PORT"):
        address_of(text, "--listen")
