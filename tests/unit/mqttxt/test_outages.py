"""What the log has of a broker that is away, and what a node without an identity is told at once."""

from __future__ import annotations

import asyncio
import logging
import re
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from ssl import CERT_REQUIRED, PROTOCOL_TLS_SERVER, SSLContext

import pytest

from mqttxt.core.address import BrokerAddress
from mqttxt.core.effects import Subscribe
from mqttxt.core.mqtt import link as mqtt_module
from mqttxt.core.mqtt import outage as outage_module
from mqttxt.core.mqtt.link import MqttLink
from mqttxt.core.mqtt.outage import Outage
from mqttxt.errors import ConfigurationError
from mqttxt.security.authority import Authority
from tests.rigs.linked import Heard, linked
from tests.rigs.loopback import free_port
from tests.rigs.mqtt_server import Server, publish
from tests.rigs.processes import eventually

NOT_AUTHORIZED_NOW = 0x97
"""Quota exceeded: a subscription that is refused this time."""


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.setattr(mqtt_module, "FIRST_PAUSE_S", 0.01)
    caplog.set_level(logging.INFO, "mqttxt.mqtt")


async def test_a_broker_that_is_away_is_told_of_once_and_so_is_its_return(caplog: pytest.LogCaptureFixture) -> None:
    port, heard = free_port(), Heard()
    link = MqttLink("fog 1", BrokerAddress("127.0.0.1", port), "one", None, heard, longest_pause_s=0.02, link="fog")
    failures: list[str] = []

    class Counted(Outage):
        def fail(self, reason: str, now_s: float, *, was_accepted: bool) -> None:
            failures.append(reason)
            super().fail(reason, now_s, was_accepted=was_accepted)

    link._outage = Counted("fog", link.address)
    running = asyncio.create_task(link.run())
    await eventually(lambda: len(failures) >= 3, "three attempts")
    async with Server(port=port) as server:
        await eventually(lambda: heard.connections == 1, "connected")
        server.sessions[0].send(publish("drone1/commands", b"x"))
        await eventually(lambda: len(heard.messages) == 1, "served")
        count = len(failures)
    await eventually(lambda: heard.losses == 1, "lost")
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)
    lines = [record.getMessage() for record in caplog.records if record.name == "mqttxt.mqtt"]
    where = f"mqtt://127.0.0.1:{port}"
    assert lines[0] == f"fog: {where}: Connection refused; trying again"
    assert re.fullmatch(rf"fog: connected to {where} after \d+\.\d s, {count} failed attempts", lines[1])
    assert lines[2] == f"fog: {where}: connection lost; trying again"


@pytest.mark.long
async def test_a_broker_that_accepts_in_vain_is_told_of_once(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(outage_module, "IN_VAIN_S", 0.5)
    async with Server(granted=[NOT_AUTHORIZED_NOW] * 3) as server, linked(server) as (link, heard):
        for number in range(1, 5):
            await eventually(lambda number=number: heard.connections == number, "connected")  # type: ignore[misc]
            link.subscribe(Subscribe("fog", ("drone1/commands",)))
        await eventually(lambda: len(heard.subscribes) == 1, "subscribed")
        await eventually(lambda: " after " in caplog.text, "the return is told of")
    lines = [record.getMessage() for record in caplog.records if record.name == "mqttxt.mqtt"]
    assert sum("was refused with reason code 0x97; trying again" in line for line in lines) == 1
    assert sum("connected to" in line for line in lines) == 2


def demanding(acme: Authority) -> SSLContext:
    """A broker's context that demands a certificate of the fleet."""
    broker = acme.issue("broker-cloud", hosts=("localhost",))
    context = SSLContext(PROTOCOL_TLS_SERVER)
    context.load_cert_chain(broker / "certificate.pem", broker / "identity.pem")
    context.load_verify_locations(broker / "fleet.pem")
    context.verify_mode = CERT_REQUIRED
    return context


@contextmanager
def refusing(context: SSLContext) -> Iterator[int]:
    """A TLS server on loopback, which says why it refuses; its port."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            with suppress(OSError):
                while True:
                    taken, _ = server.accept()
                    with taken, suppress(OSError):
                        context.wrap_socket(taken, server_side=True)

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            yield int(server.getsockname()[1])
        finally:
            server.shutdown(socket.SHUT_RDWR)
            thread.join()


@pytest.mark.parametrize("was_up", [False, True])
async def test_a_node_without_the_certificate_that_a_broker_demands_ends_at_once(
    was_up: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that was connected before goes on trying: what a broker says after a restart ends no node in flight."""
    acme = Authority.create(tmp_path / "acme", "acme")
    monkeypatch.setenv("SSL_CERT_FILE", str(acme.folder / "fleet.pem"))
    with refusing(demanding(acme)) as port:
        link = MqttLink("cloud", BrokerAddress("localhost", port, tls=True), "one", None, Heard())
        link._has_been_up = was_up
        running = asyncio.create_task(link.run())
        await eventually(lambda: running.done() or link.failure is not None, "an outcome")
        assert running.done() == (not was_up)
        running.cancel()
        (ended,) = await asyncio.gather(running, return_exceptions=True)
    said = "the broker demands a certificate of this node; expected an identity (`identity`)"
    if was_up:
        assert link.failure == said
    else:
        assert isinstance(ended, ConfigurationError)
        assert str(ended) == f"mqtts://localhost:{port}: {said}"


async def test_a_broker_of_an_unknown_authority_is_told_of_with_the_parameter(tmp_path: Path) -> None:
    acme = Authority.create(tmp_path / "acme", "acme")
    async with Server(tls=demanding(acme)) as server:
        link = MqttLink("cloud", BrokerAddress("localhost", server.port, tls=True), "one", None, Heard())
        running = asyncio.create_task(link.run())
        await eventually(lambda: link.failure is not None, "an outcome")
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
    assert link.failure is not None
    assert link.failure.endswith("; a fleet's own broker is known by an identity (`identity`)")
