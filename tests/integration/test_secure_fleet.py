"""A fleet with identities, as real processes on real Mosquittos: mutual TLS on every leg, and nothing beside it."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import time
from collections.abc import Iterator
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
from tests.quick import LANDING, quick_fleet
from tests.rigs.processes import Process, eventually, free_port, wait_until
from tests.rigs.secure import WITNESS, Node, SecureBroker

pytestmark = [pytest.mark.integration, pytest.mark.apart]


class SecureSystem:
    """A cloud's and a fog's broker, an activator, one drone with its sensors' broker, an autopilot and a sensor."""

    def __init__(self, folder: Path, signed: bool = False, *of_the_drone: str, prefix: str = "") -> None:
        self.folder = folder
        self.acme = acme = Authority.create(folder / "acme", "acme")
        brokers = ("broker-cloud", "broker-fog1", "broker-drone1")
        for name in (*brokers, "fog1", "drone1", "sensor7"):
            acme.issue(name)
        acme.issue("gs-ops", Rights(None, take_over=True, observe=True))
        acme.issue("gs-view", Rights(observe=True))
        self.brokers = {name: SecureBroker(acme, name, prefix if name == brokers[0] else "") for name in brokers}
        cloud, fog, field = (str(broker.address) for broker in self.brokers.values())
        port = free_port(socket.SOCK_DGRAM)
        sitl = ["fly", "--fleet", str(quick_fleet(folder, LANDING)), "--system", "1", "--listen", "127.0.0.1:0"]
        activator = ["activator", "--fog", "1", "--cloud", cloud, "--fog-broker", fog, "--drones", "1"]
        activator += ["--audit", str(folder / "fog1.audit"), "--prefix", prefix]
        uav = ["uav", "--drone", "1", "--broker", fog, "--autopilot", f"udp:127.0.0.1:{port}", "--sensor-broker", field]
        uav += of_the_drone
        sitl += ["--events", str(folder / "sitl.jsonl")]
        files = ["--journal", str(folder / "journal"), "--sensor-store", str(folder / "readings")]
        files += ["--audit", str(folder / "drone1.audit")]
        sensor = ["--broker", field, "--number", "7", "--kinds", "temperature", "--rate", "5"]
        signing, sensing = (("--signed", "--signed-readings"), ("--signed",)) if signed else ((), ())
        self.processes = [
            self._process(folder, "sitl", "sitl", *sitl, "--send", f"127.0.0.1:{port}"),
            self._process(folder, "activator", "mqttxt", *activator, "--identity", str(acme.folder / "fog1"), *signing),
            self._process(
                *(folder, "uav", "mqttxt", *uav, *files, "--identity", str(acme.folder / "drone1"), *signing),
                *(("--fog", "1") if signed else ()),
            ),
            self._process(folder, "sensor", "sensor", *sensor, "--identity", str(acme.folder / "sensor7"), *sensing),
        ]

    def _process(self, folder: Path, name: str, module: str, *arguments: str) -> Process:
        return Process(folder, name, module, *arguments, "--ready-file", str(folder / f"{name}.ready"))

    @property
    def url(self) -> str:
        return str(self.brokers["broker-cloud"].address)

    def station(self, name: str = "gs-ops", signed: bool = False) -> GroundStation:
        return GroundStation(self.url, identity=self.acme.folder / name, signed=signed, signed_readings=signed)

    def start(self) -> None:
        for broker in self.brokers.values():
            broker.start()
        for process in self.processes:
            process.start()
        for process in self.processes:
            process.wait_ready()

    def close(self) -> None:
        for process in self.processes:
            process.kill()
        for broker in self.brokers.values():
            broker.kill()


@pytest.fixture
def system(tmp_path: Path) -> Iterator[SecureSystem]:
    found = SecureSystem(tmp_path)
    try:
        found.start()
        yield found
    finally:
        found.close()


async def test_a_drone_is_flown_and_its_sensor_is_heard_over_mutual_tls_alone(system: SecureSystem) -> None:
    async with system.station() as station:
        assert station.name == "ops"
        (fog,) = await station.connect([1])
        drone = fog.drone(1)
        await eventually(lambda: drone.is_reachable and drone.is_controlled, "drone 1 is reachable and controlled")
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
    cloud = system.brokers["broker-cloud"].address
    theirs = Authority.create(tmp_path / "theirs", "acme").issue("gs-ops", Rights(None))
    plain = str(BrokerAddress(cloud.host, cloud.port))
    for url, options in ((plain, {}), (system.url, {}), (system.url, {"identity": theirs})):
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
    system.brokers["broker-cloud"].files.write_access(system.brokers["broker-cloud"].out)
    system.brokers["broker-cloud"].reload()
    with pytest.raises(ConfigurationError, match="gs-ops: revoked"):
        system.station()
    async with station:
        with pytest.raises(FogUnreachable, match="it refuses this node's certificate: certificate revoked"):
            await station.connect([1], timeout_s=5)


@pytest.fixture
def signed(tmp_path: Path) -> Iterator[SecureSystem]:
    found = SecureSystem(tmp_path, signed=True)
    found.acme.issue("gs-two", Rights(None))
    for broker in found.brokers.values():
        broker.files.write_access(broker.out)
    try:
        found.start()
        yield found
    finally:
        found.close()


async def test_a_revoked_station_is_refused_within_a_second_of_the_lists_arrival(signed: SecureSystem) -> None:
    """Nobody sends a signal: a station that has the list gives it to the broker, and all others take it from there."""
    async with signed.station(signed=True) as station, signed.station("gs-two", signed=True) as second:
        (fog,), (others,) = await station.connect([1]), await second.connect([1])
        drone, other = fog.drone(1), others.drone(1)
        await eventually(lambda: drone.is_controlled, "drone 1 is controlled")
        assert (await drone.arm()).completed
        signed.acme.revoke("gs-ops")
        async with signed.station("gs-view", signed=True) as bringer:
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


async def test_keys_are_renewed_and_the_old_ones_revoked_without_losing_a_command(signed: SecureSystem) -> None:
    acme = signed.acme
    processes = {process.name: process for process in signed.processes}
    async with signed.station(signed=True) as station:
        (fog,) = await station.connect([1])
        drone = fog.drone(1)
        await eventually(lambda: drone.is_controlled, "drone 1 is controlled")
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
    system.brokers["broker-fog1"].files.write_access(system.brokers["broker-fog1"].out)
    system.brokers["broker-fog1"].let_witness()
    try:
        system.start()
        async with system.station(signed=True) as station:
            (fog,) = await station.connect([1])
            drone = fog.drone(1)
            await eventually(lambda: drone.is_reachable and drone.is_controlled, "drone 1 is reachable and controlled")
            armed = await drone.arm()
            assert (armed.word, armed.signer) == (Word.COMPLETED, "drone1")
            witness = Node(Identity.load(system.acme.folder / WITNESS), system.brokers["broker-fog1"])
            attack = CommandMessage(
                gs_session=station.session, seq=9, executor_session=7, deadline_ms=10**9, limit_s=9.0, command=Disarm()
            )
            forged = Seal(Identity.load(system.acme.folder / WITNESS)).sign("drone1/commands", encode(attack), True)
            for payload in (encode(attack), forged.encode()):
                witness.publish(["drone1/commands"], payload)
            assert (await drone.takeoff(5)).completed  # it was not disarmed
            await eventually(lambda: len(drone.readings) > 0, "a reading has come that its sensor signed")
            (landed,) = await fog.broadcast(Land())
            assert (landed.word, landed.signer) == (Word.COMPLETED, "drone1")
            assert not [topic for topic, _ in witness.heard if topic.endswith("commands_result/disarm")]
            witness.close()
        async with system.station() as unsigned:
            with pytest.raises(FogUnreachable, match=r"its activator signs .*expected --signed"):
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
