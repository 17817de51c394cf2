"""Members of a fleet that flood, at real brokers with the generated configuration: the others' commands get through."""

from __future__ import annotations

from contextlib import ExitStack, closing
from pathlib import Path

import pytest

from mqttxt import Hold, Word
from mqttxt.protocol.cbor import MAX_PAYLOAD
from mqttxt.security import broker as brokers
from mqttxt.security.authority import Authority
from mqttxt.security.identity import Identity
from mqttxt.security.rights import Rights
from tests.rigs.flooder import KINDS
from tests.rigs.processes import Process
from tests.rigs.secure import WITNESS, Node, SecureBroker
from tests.rigs.secure_system import SecureSystem

pytestmark = [pytest.mark.integration, pytest.mark.apart]
OTHERS = pytest.mark.soak("services/mqttxt/src/mqttxt/core", "services/mqttxt/src/mqttxt/activator")

COMMANDS = 10


@pytest.mark.parametrize(
    "kind", ["commands", *(pytest.param(kind, marks=OTHERS) for kind in KINDS if kind != "commands")]
)
async def test_a_station_that_floods_stops_nobody(tmp_path: Path, kind: str) -> None:
    system = SecureSystem(tmp_path, signed=True)
    eve = system.acme.issue("gs-eve", Rights(frozenset({1}), observe=True))
    system.let_in()
    options = (str(eve), str(system.cloud.port), kind, str(tmp_path / "eve.ready"))
    flooder = Process(tmp_path, "eve", "tests.rigs.flooder", *options)
    try:
        async with system.flying() as (_, drone):
            flooder.start().wait_ready()
            said = [await drone.send(Hold(), ttl_s=30, limit_s=30) for _ in range(COMMANDS)]
            assert flooder.exit_code is None, flooder.log.read_text()[-2000:]
            assert [one.word for one in said] == [Word.COMPLETED] * COMMANDS
    finally:
        flooder.kill()


@pytest.fixture
def acme(tmp_path: Path) -> Authority:
    found = Authority.create(tmp_path / "acme", "acme")
    for name in ("broker-cloud", "fog1", WITNESS):
        found.issue(name)
    return found


def connected(stack: ExitStack, acme: Authority, name: str, broker: SecureBroker) -> Node:
    return stack.enter_context(closing(Node(Identity.load(acme.folder / name), broker)))


def test_a_broker_takes_no_longer_payload_than_the_specification_has(acme: Authority) -> None:
    broker = SecureBroker(acme, "broker-cloud")
    broker.let_witness()
    with ExitStack() as stack:
        stack.callback(broker.start().kill)
        witness, fog = (connected(stack, acme, name, broker) for name in (WITNESS, "fog1"))
        longest, longer = bytes(MAX_PAYLOAD), bytes(MAX_PAYLOAD + 1)
        for payload in (longest, longer):  # Mosquitto 2.0.11 hangs up, newer ones refuse
            fog.publish(["fog1/PSMI"], payload)
        witness.catch_up()
        assert witness.heard == {("fog1/PSMI", longest)}


def test_a_broker_takes_as_many_connections_as_its_configuration_says(
    acme: Authority, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(brokers, "MOST_CONNECTIONS", 3)
    broker = SecureBroker(acme, "broker-cloud")
    with ExitStack() as stack:
        stack.callback(broker.start().kill)
        first, *_ = [connected(stack, acme, "fog1", broker) for _ in range(3)]
        with pytest.raises((ConnectionError, OSError)):
            connected(stack, acme, "fog1", broker)
        first.publish(["fog1/clock"], b"still there")
        first.catch_up()
        assert ("fog1/clock", b"still there") in first.heard
