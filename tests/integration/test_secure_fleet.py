"""A fleet with identities, as real processes on real Mosquittos: mutual TLS on every leg, and nothing beside it."""

from __future__ import annotations

import os
import signal
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from mqttxt import ConfigurationError, Disarm, FogUnreachable, GroundStation, Land, Word
from mqttxt.core.address import BrokerAddress
from mqttxt.protocol.codec import encode
from mqttxt.protocol.messages import CommandMessage
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

    def __init__(self, folder: Path, *signed: str) -> None:
        self.acme = acme = Authority.create(folder / "acme", "acme")
        brokers = ("broker-cloud", "broker-fog1", "broker-drone1")
        for name in (*brokers, "fog1", "drone1", "sensor7"):
            acme.issue(name)
        acme.issue("gs-ops", Rights(None, take_over=True, observe=True))
        acme.issue("gs-view", Rights(observe=True))
        self.brokers = {name: SecureBroker(acme, name) for name in brokers}
        cloud, fog, field = (str(broker.address) for broker in self.brokers.values())
        port = free_port(socket.SOCK_DGRAM)
        sitl = ["fly", "--fleet", str(quick_fleet(folder, LANDING)), "--system", "1", "--listen", "127.0.0.1:0"]
        activator = ["activator", "--fog", "1", "--cloud", cloud, "--fog-broker", fog, "--drones", "1"]
        uav = ["uav", "--drone", "1", "--broker", fog, "--autopilot", f"udp:127.0.0.1:{port}", "--sensor-broker", field]
        files = ["--journal", str(folder / "journal"), "--sensor-store", str(folder / "readings")]
        sensor = ["--broker", field, "--number", "7", "--kinds", "temperature", "--rate", "5"]
        self.processes = [
            self._process(folder, "sitl", "sitl", *sitl, "--send", f"127.0.0.1:{port}"),
            self._process(folder, "activator", "mqttxt", *activator, "--identity", str(acme.folder / "fog1"), *signed),
            self._process(
                *(folder, "uav", "mqttxt", *uav, *files, "--identity", str(acme.folder / "drone1"), *signed),
                *(("--fog", "1") if signed else ()),
            ),
            self._process(folder, "sensor", "sensor", *sensor, "--identity", str(acme.folder / "sensor7")),
        ]

    def _process(self, folder: Path, name: str, module: str, *arguments: str) -> Process:
        return Process(folder, name, module, *arguments, "--ready-file", str(folder / f"{name}.ready"))

    @property
    def url(self) -> str:
        return str(self.brokers["broker-cloud"].address)

    def station(self, name: str = "gs-ops", signed: bool = False) -> GroundStation:
        return GroundStation(self.url, identity=self.acme.folder / name, signed=signed)

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


async def test_a_fleet_that_signs_is_flown_and_obeys_nobody_else(tmp_path: Path) -> None:
    """A client whom the fog's broker lets say anything, as a broker could itself, and stations that do not sign."""
    system = SecureSystem(tmp_path, "--signed")
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
            (landed,) = await fog.broadcast(Land())
            assert (landed.word, landed.signer) == (Word.COMPLETED, "drone1")
            assert not [topic for topic, _ in witness.heard if topic.endswith("commands_result/disarm")]
            witness.close()
        async with system.station() as unsigned:
            with pytest.raises(FogUnreachable, match="no activator is at"):
                await unsigned.connect([1], timeout_s=2)
    finally:
        system.close()
