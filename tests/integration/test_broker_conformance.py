"""The conformance kit at brokers: Mosquitto has all that is needed, and what a broker lacks is found by its rule."""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from mqttxt.cli.main import app
from mqttxt.core.address import BrokerAddress
from mqttxt.security.authority import Authority
from mqttxt_conformance.broker import BrokerTarget
from mqttxt_conformance.broker_kit import BrokerKit
from mqttxt_conformance.registry import RULES, Finding, Verdict, check_all
from tests.rigs.faulty_broker import FAULTS, FAULTS_OF_NODES, NARROW, FaultyBroker
from tests.rigs.processes import Broker, free_port
from tests.rigs.secure import WITNESS, SecureBroker

pytestmark = [pytest.mark.integration, pytest.mark.apart, pytest.mark.timeout(180)]
SOAK = pytest.mark.soak(
    *(f"services/mqttxt/src/mqttxt_conformance/{name}.py" for name in ("tap", "broker_kit", "broker_delivery")),
    *(f"services/mqttxt/src/mqttxt_conformance/{name}.py" for name in ("broker_retained", "broker_sessions")),
    *("tests/rigs/faulty_broker.py", "tests/rigs/mqtt_server.py"),
)


@pytest.fixture(scope="module")
def mosquitto(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Broker]:
    broker = Broker(tmp_path_factory.mktemp("mosquitto"), "cloud").start()
    yield broker
    broker.kill()


async def check(rule: str, *urls: str) -> Finding:
    """One rule at a broker of one or more nodes."""
    kit = BrokerKit(BrokerTarget(tuple(BrokerAddress.parse(url) for url in urls)))
    await kit.begin()
    try:
        (found,) = await check_all([one for one in RULES["broker"] if one.name == rule], kit, lambda finding: None)
        return found
    finally:
        await kit.end()


def test_mosquitto_2_0_lacks_aliases_towards_clients_alone_and_nothing_is_left_there(mosquitto: Broker) -> None:
    result = CliRunner().invoke(app, ["conformance", "broker", mosquitto.url, "--format", "json", "--name", "M"])
    assert result.exit_code == 0, result.output
    report = json.loads(result.stdout)
    assert (report["name"], report["side"]) == ("M", "cloud")
    verdicts = {finding["rule"]: finding["verdict"] for finding in report["findings"]}
    assert [rule for rule, verdict in verdicts.items() if verdict == "fail"] == ["sends-topic-aliases"]
    alone = {rule for rule, verdict in verdicts.items() if verdict == "not tested"}
    assert alone == set(FAULTS_OF_NODES)


@SOAK
@pytest.mark.parametrize("rule", FAULTS)
async def test_what_a_broker_lacks_is_found_by_its_rule(rule: str, mosquitto: Broker) -> None:
    async with FaultyBroker(mosquitto.port, FAULTS[rule]) as faulty:
        found = await check(rule, faulty.url)
    assert found.verdict is Verdict.FAIL, found.evidence


async def test_the_kit_keeps_to_the_brokers_receive_maximum(mosquitto: Broker) -> None:
    async with FaultyBroker(mosquitto.port, NARROW) as narrow:
        found = await check("keeps-the-order", narrow.url)
    assert found.verdict is Verdict.PASS, found.evidence


@SOAK
@pytest.mark.parametrize("rule", FAULTS_OF_NODES)
async def test_what_nodes_do_not_share_is_found_by_its_rule(rule: str, mosquitto: Broker) -> None:
    async with FaultyBroker(mosquitto.port) as node, FaultyBroker(mosquitto.port, FAULTS_OF_NODES[rule]) as faulty:
        assert (await check(rule, mosquitto.url, node.url)).verdict is Verdict.PASS
        found = await check(rule, mosquitto.url, faulty.url)
    assert found.verdict is Verdict.FAIL, found.evidence


@pytest.mark.parametrize(("side", "code"), [pytest.param("cloud", 0, marks=SOAK), ("fog", 1)])
async def test_what_a_side_needs_decides(side: str, code: int, mosquitto: Broker) -> None:
    """A broker that shows nothing retained by wildcard serves as the cloud's, and not as a fog's."""
    async with FaultyBroker(mosquitto.port, FAULTS["shows-retained-by-wildcard"]) as faulty:
        kit = [sys.executable, "-m", "mqttxt", "conformance", "broker", faulty.url, "--side", side]
        process = await asyncio.create_subprocess_exec(*kit, stdout=asyncio.subprocess.PIPE)
        out, _ = await process.communicate()
    assert process.returncode == code, out.decode()
    missing = "shows-retained-by-wildcard" if side == "fog" else "nothing"
    assert f"needed of a {side} broker, and missing: {missing}" in out.decode()


def test_what_cannot_be_checked_is_one_line(mosquitto: Broker, tmp_path: Path) -> None:
    closed = Broker(tmp_path, "closed")
    text = closed.configuration.read_text().replace("allow_anonymous true", "allow_anonymous false")
    closed.configuration.write_text(text)
    closed.start()
    nowhere = f"mqtt://127.0.0.1:{free_port()}"
    try:
        for arguments, said in (
            ([nowhere], "no broker answers"),
            ([mosquitto.url.replace("mqtt://", "mqtts://")], "no broker answers"),
            ([closed.url], "refused with reason code 0x87"),
            (["http://127.0.0.1"], "expected mqtt://HOST[:PORT]"),
            ([mosquitto.url, nowhere], "no broker answers"),
            ([mosquitto.url, "--side", "moon"], "--side 'moon': expected cloud, fog or drone"),
            ([mosquitto.url, "--prefix", "a+/"], "topic prefix"),
            ([mosquitto.url, "--identity", str(tmp_path)], str(tmp_path)),
        ):
            result = CliRunner().invoke(app, ["conformance", "broker", *arguments])
            assert result.exit_code == 2, (arguments, result.output)
            assert said in result.stderr
            assert len(result.stderr.strip().splitlines()) == 1, result.stderr
    finally:
        closed.kill()


def test_it_has_a_nodes_identity_where_that_is_asked_for(tmp_path: Path) -> None:
    acme = Authority.create(tmp_path / "acme", "acme")
    for name in ("broker-cloud", "fog1", WITNESS):
        acme.issue(name)
    broker = SecureBroker(acme, "broker-cloud")
    broker.let_witness()
    broker.start()
    try:
        url = f"mqtts://localhost:{broker.port}"
        for name, code in ((WITNESS, 0), ("fog1", 2)):
            arguments = ["conformance", "broker", url, "--identity", str(acme.folder / name)]
            result = CliRunner().invoke(app, arguments)
            assert result.exit_code == code, result.output
        assert "expected an access list that lets this client" in result.stderr
    finally:
        broker.kill()
