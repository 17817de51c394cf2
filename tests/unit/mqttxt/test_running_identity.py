"""An identity while its node runs: revocation lists, time, a certificate that ends in flight, an embedded broker."""

from __future__ import annotations

import asyncio
import logging
import sys
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import pytest

from mqttxt import Arm, ConfigurationError, FogUnreachable, Goto, GroundStation, Hold, Land, Return
from mqttxt.core.clock import SessionClock
from mqttxt.core.embedded_broker import EmbeddedBroker
from mqttxt.core.runner import Runner
from mqttxt.core.settings import Settings
from mqttxt.drone.role import UavClient
from mqttxt.protocol.rankings import SelectMode
from mqttxt.security.authority import Authority
from mqttxt.security.broker import BrokerFiles
from mqttxt.security.identity import Identity
from mqttxt.security.rights import Rights
from mqttxt.station.outcomes import last_word

DAY_S = 86_400.0
MOSQUITTO = """#!{python}
import shutil, signal, sys
signal.signal(signal.SIGHUP, lambda *_: open("{folder}/said", "w").close())
shutil.copy(sys.argv[2], "{folder}/seen.conf")
print("1: mosquitto version 2.0.21 running", file=sys.stderr, flush=True)
while True:
    signal.pause()
"""


class Clock:
    """The system's clock, as one sets it."""

    def __init__(self) -> None:
        self.ahead_s = 0.0

    def __call__(self) -> float:
        return datetime.now(UTC).timestamp() + self.ahead_s


@pytest.fixture
def acme(tmp_path: Path) -> Authority:
    return Authority.create(tmp_path / "acme", "acme")


def runner_of(identity: Identity) -> Runner:
    clock = SessionClock()
    return Runner(UavClient(1, clock.session, Settings()), clock, identity=identity)


async def until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(20):
        while not condition():
            await asyncio.sleep(0.01)


async def test_a_reload_takes_the_newer_list_and_a_bad_one_changes_nothing(
    acme: Authority, caplog: pytest.LogCaptureFixture
) -> None:
    folder = acme.issue("drone1")
    runner = runner_of(Identity.load(folder))
    assert runner.identity is not None
    acme.issue("gs-a")
    acme.revoke("gs-a")
    caplog.set_level(logging.INFO, "mqttxt")
    await runner.reload()
    assert runner.identity.fleet.revoked.number == 2
    assert "revocation list 2" in caplog.text
    (folder / "revoked.pem").write_bytes(b"")
    await runner.reload()
    assert runner.identity.fleet.revoked.number == 2
    assert f"{folder}/revoked.pem: not a certificate revocation list" in caplog.text


def station_of(acme: Authority) -> tuple[GroundStation, Clock]:
    """A station whose certificate ends after a day of its clock."""
    clock = Clock()
    folder = acme.issue("gs-ops", Rights(None), days=1)
    station = GroundStation("mqtts://localhost:1", identity=folder)
    station._runner.identity = Identity.load(folder, system=clock)
    return station, clock


async def test_a_running_node_keeps_the_time_and_says_when_its_certificate_ends(
    acme: Authority, caplog: pytest.LogCaptureFixture
) -> None:
    station, clock = station_of(acme)
    clock.ahead_s = 2 * DAY_S
    async with station:
        await until(lambda: "the certificate of gs-ops is expired" in caplog.text)
    with pytest.raises(ConfigurationError, match="gs-ops: expired"):
        Identity.load(acme.folder / "gs-ops", system=lambda: 0.0)


async def test_a_station_whose_certificate_ends_in_flight_can_still_bring_its_drones_down(acme: Authority) -> None:
    station, clock = station_of(acme)
    runner = station._runner
    clock.ahead_s = 2 * DAY_S
    async with station:
        runner.carry_out(runner.station.add_fogs([1]))
        fog = runner.station.fogs[1]
        for command in (Hold(), Land(), Return()):
            with pytest.raises(FogUnreachable):
                runner.send(fog, 1, command, 5.0, None, last_word)
        said = "this station's certificate is expired; expected hold, land or return"
        with pytest.raises(ConfigurationError, match=f"arm: {said}"):
            runner.send(fog, 1, Arm(), 5.0, None, last_word)
        with pytest.raises(ConfigurationError, match=f"goto: {said}"):
            runner.select(1, Goto(47.0, 8.0, 20.0), SelectMode.SELECT, 5.0)
        clock.ahead_s = 0.0
        with pytest.raises(FogUnreachable):
            runner.send(fog, 1, Arm(), 5.0, None, last_word)


async def test_an_embedded_broker_with_an_identity(acme: Authority, tmp_path: Path) -> None:
    folder = acme.issue("broker-fog1")
    acme.issue("fog1")
    acme.issue("drone1")
    program = tmp_path / "mosquitto"
    program.write_text(MOSQUITTO.format(python=sys.executable, folder=tmp_path))
    program.chmod(0o755)
    broker = EmbeddedBroker("127.0.0.1", 18831, program=str(program), files=BrokerFiles(folder))
    assert broker.url == "mqtts://127.0.0.1:18831"
    running = asyncio.create_task(broker.run())
    try:
        await until(lambda: (tmp_path / "seen.conf").exists())
        text = (tmp_path / "seen.conf").read_text()
        assert "listener 18831 127.0.0.1\nallow_anonymous false\nrequire_certificate true\n" in text
        access = Path(text.rpartition("acl_file ")[2].strip())
        assert "user drone1\n" in access.read_text()
        acme.revoke("drone1")
        await asyncio.to_thread(broker.reload)
        assert "user drone1\n" not in access.read_text()
        await until(lambda: (tmp_path / "said").exists())
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
    assert not access.exists()
