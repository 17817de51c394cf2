"""A fleet with identities, as real processes on real Mosquittos: mutual TLS on every leg, and nothing beside it."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from mqttxt import ConfigurationError, Disarm, FogUnreachable, GroundStation, Land, Word
from mqttxt.core.address import BrokerAddress
from mqttxt.protocol.codec import encode
from mqttxt.protocol.messages import CommandMessage
from mqttxt.security.audit_verdict import AuditVerdict
from mqttxt.security.authority import Authority
from mqttxt.security.identity import Identity
from mqttxt.security.rights import Rights
from mqttxt.security.seal import Seal
from tests.rigs.commanding import controlled
from tests.rigs.processes import eventually, wait_until
from tests.rigs.secure import WITNESS, Node
from tests.rigs.secure_system import SecureSystem

pytestmark = [pytest.mark.integration, pytest.mark.apart]


@pytest.fixture
def system(tmp_path: Path) -> Iterator[SecureSystem]:
    with closing(SecureSystem(tmp_path)) as found:
        found.start()
        yield found


async def test_a_drone_is_flown_and_its_sensor_is_heard_over_mutual_tls_alone(system: SecureSystem) -> None:
    async with system.station() as station:
        assert station.name == "ops"
        drone = await controlled(station)
        assert (await drone.arm()).completed
        await eventually(lambda: len(drone.readings) > 0, "a reading has come")

        async with system.station("gs-view") as watcher:
            (seen,) = await watcher.connect([1])
            await eventually(lambda: bool(seen.drone(1).states), "who may observe hears states")
            refused = await seen.drone(1).disarm(ttl_s=1)
            assert refused.word is not Word.COMPLETED  # the broker drops it
        assert (await drone.disarm()).completed


async def test_who_has_no_identity_gets_nowhere(system: SecureSystem, tmp_path: Path) -> None:
    """Not without TLS, not with TLS alone, not with another fleet's certificate."""
    cloud = system.cloud.address
    theirs = Authority.create(tmp_path / "theirs", "acme").issue("gs-ops", Rights(None))
    plain = str(BrokerAddress(cloud.host, cloud.port))
    for url, options in ((plain, {}), (system.cloud_url, {}), (system.cloud_url, {"identity": theirs})):
        async with GroundStation(url, **options) as station:
            with pytest.raises(FogUnreachable, match=r"fog 1: no connection to"):
                await station.connect([1], timeout_s=2)


def test_a_running_node_takes_a_new_list_at_sighup(system: SecureSystem) -> None:
    system.acme.revoke("gs-view")
    for process in system.processes[1:]:
        os.kill(process.pid, signal.SIGHUP)
        wait_until(lambda process=process: "revocation list 2" in process.log.read_text(), f"{process.name}: list 2")
        assert process.exit_code is None


async def test_a_revoked_station_is_named_so(system: SecureSystem) -> None:
    station = system.station()
    system.acme.revoke("gs-ops")
    system.cloud.files.write_access(system.cloud.out)
    system.cloud.reload()
    with pytest.raises(ConfigurationError, match="gs-ops: revoked"):
        system.station()
    async with station:
        with pytest.raises(FogUnreachable, match="it refuses this node's certificate: certificate revoked"):
            await station.connect([1], timeout_s=5)


@pytest.fixture
def signed(tmp_path: Path) -> Iterator[SecureSystem]:
    found = SecureSystem(tmp_path, signed=True)
    found.acme.issue("gs-two", Rights(None))
    found.let_in()
    with closing(found):
        found.start()
        yield found


async def test_a_revoked_station_is_refused_within_a_second_of_the_lists_arrival(signed: SecureSystem) -> None:
    """Nobody sends a signal: a station that has the list gives it to the broker, and all others take it from there."""
    async with signed.station() as station, signed.station("gs-two") as second:
        (fog,), (others,) = await station.connect([1]), await second.connect([1])
        drone, other = fog.drone(1), others.drone(1)
        await eventually(lambda: drone.is_controlled, "drone 1 is controlled")
        assert (await drone.arm()).completed
        signed.acme.revoke("gs-ops")
        async with signed.station("gs-view") as bringer:
            assert await bringer.share_list() == 2
        shared_s = time.monotonic()
        answered: list[float] = []

        async def ask() -> None:
            async for _ in drone.hold(ttl_s=1, limit_s=1):
                answered.append(time.monotonic())

        asking = []
        while time.monotonic() < shared_s + 2.0:
            asking.append(asyncio.ensure_future(ask()))
            await asyncio.sleep(0.05)
        assert [at_s for at_s in answered if at_s > shared_s + 1.0] == []
        await eventually(lambda: other.is_controlled, "the next station controls what the revoked one gave up")
        assert (await other.disarm()).completed
        for task in asking:
            task.cancel()
    sensor = signed.processes[-1]
    wait_until(lambda: "revocation list 2" in sensor.log.read_text(), "the drone has given it to its sensor")
    for name in ("fog1", "drone1"):
        assert Identity.load(signed.acme.folder / name).fleet.revoked.number == 2
        assert (signed.acme.folder / name / "newest.pem").exists()


@pytest.mark.soak(*(f"services/mqttxt/src/mqttxt/{part}" for part in ("core", "security", "cli/keys.py")))
async def test_keys_are_renewed_and_the_old_ones_revoked_without_losing_a_command(signed: SecureSystem) -> None:
    acme = signed.acme
    processes = {process.name: process for process in signed.processes}
    async with signed.station() as station:
        drone = await controlled(station)
        words: list[Word] = []

        async def fly(count: int) -> None:
            for _ in range(count):
                words.append((await drone.arm()).word)
                words.append((await drone.disarm()).word)

        flying = asyncio.ensure_future(fly(15))
        for name, process in (("fog1", processes["activator"]), ("drone1", processes["uav"])):
            acme.renew(name)
            os.kill(process.pid, signal.SIGHUP)
            said = f"{name} signs with its new key"
            await eventually(lambda process=process, said=said: said in process.log.read_text(), said)
        acme.renew("gs-ops")
        await station.reload()
        await flying
        flying = asyncio.ensure_future(fly(10))
        for name in ("fog1", "drone1", "gs-ops"):
            assert acme.revoke(name, only_old=True) == 1
        await station.reload()
        assert await station.share_list() == 4
        for process in (processes["activator"], processes["uav"]):
            await eventually(lambda process=process: "revocation list 4" in process.log.read_text(), "list 4")
        await flying
        await fly(2)
        assert set(words) == {Word.COMPLETED}


async def test_a_fleet_that_signs_is_flown_and_obeys_nobody_else(tmp_path: Path) -> None:
    """A client whom the fog's broker lets say anything, as a broker could itself, and stations that do not sign."""
    system = SecureSystem(tmp_path, signed=True)
    system.acme.issue(WITNESS)
    system.fog.files.write_access(system.fog.out)
    system.fog.let_witness()
    try:
        system.start()
        async with system.station() as station:
            drone = await controlled(station)
            armed = await drone.arm()
            assert (armed.word, armed.signer) == (Word.COMPLETED, "drone1")
            witness = Node(Identity.load(system.acme.folder / WITNESS), system.fog)
            attack = CommandMessage(
                gs_session=station.session, seq=9, executor_session=7, deadline_ms=10**9, limit_s=9.0, command=Disarm()
            )
            forged = Seal(Identity.load(system.acme.folder / WITNESS)).sign("drone1/commands", encode(attack), True)
            for payload in (encode(attack), forged.encode()):
                witness.publish(["drone1/commands"], payload)
            assert (await drone.takeoff(5)).completed  # it was not disarmed
            await eventually(lambda: len(drone.readings) > 0, "a reading has come that its sensor signed")
            (landed,) = await station.fog(1).broadcast(Land())
            assert (landed.word, landed.signer) == (Word.COMPLETED, "drone1")
            assert not [topic for topic, _ in witness.heard if topic.endswith("commands_result/disarm")]
            witness.close()
        async with system.station(signed=False) as unsigned:
            with pytest.raises(FogUnreachable, match=r"its activator signs .*expected `signed`"):
                await unsigned.connect([1], timeout_s=2)
        assert [process.stop() for process in system.processes[1:3]] == [0, 0]
    finally:
        system.close()
    for node in ("fog1", "drone1"):
        found = AuditVerdict(system.acme.fleet)
        found.read([tmp_path / f"{node}.audit"])
        assert found.unproven == 0
        lines = [json.loads(line) for line in (tmp_path / f"{node}.audit").read_bytes().splitlines()]
        said = [(line["who"], line["signed"], line["said"]) for line in lines if line["event"] in ("command", "word")]
        assert [(who, signed, one.get("command")) for who, signed, one in said if "command" in one] == [
            ("gs-ops", True, name) for name in ("arm", "takeoff", "land")
        ]
        words = [(who, signed, one["word"]) for who, signed, one in said if "word" in one]
        assert words == [("drone1", True, "completed")] * 3
