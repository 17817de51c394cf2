"""An identity while its node runs: revocation lists, time, a certificate that ends in flight, an embedded broker."""

from __future__ import annotations

import asyncio
import logging
import shutil
import sys
import time
from datetime import UTC, datetime
from pathlib import Path

import pytest

from mqttxt import Arm, ConfigurationError, FogUnreachable, Goto, GroundStation, Hold, Land, Return
from mqttxt.activator.role import Activator
from mqttxt.core.clock import SessionClock
from mqttxt.core.effects import Inbound
from mqttxt.core.embedded_broker import EmbeddedBroker
from mqttxt.core.runner import Runner
from mqttxt.core.settings import Settings
from mqttxt.drone.role import UavClient
from mqttxt.protocol.rankings import SelectMode
from mqttxt.security.authority import Authority
from mqttxt.security.broker import ACCESS_FILE, BrokerFiles
from mqttxt.security.identity import Identity
from mqttxt.security.revocation import RevocationList
from mqttxt.security.rights import Rights
from mqttxt.station.outcomes import last_word
from tests.rigs.processes import eventually

DAY_S = 86_400.0
MOSQUITTO = """#!{python}
import os, shutil, signal, sys
signal.signal(signal.SIGHUP, lambda *_: open("{folder}/said", "w").close())
shutil.copy(sys.argv[2], "{folder}/half.conf")
os.rename("{folder}/half.conf", "{folder}/seen.conf")
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


def runner_of(identity: Identity) -> Runner:
    clock = SessionClock()
    return Runner(UavClient(1, clock.session, Settings()), clock, identity=identity, lists={"fog": "fleet/revoked"})


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


async def test_a_list_that_a_broker_shows_is_kept_and_given_to_the_nodes_own_broker(acme: Authority) -> None:
    folder = acme.issue("fog1")
    told: list[int] = []

    class Node(Runner):
        def tell_own_broker(self, newest: RevocationList) -> None:
            told.append(newest.number)

    clock = SessionClock()
    role = Activator(1, clock.session, Settings())
    runner = Node(role, clock, identity=Identity.load(folder), lists={"fog": "fleet/revoked"})
    acme.issue("gs-a")
    acme.revoke("gs-a")
    (folder / "revoked.pem").unlink()
    running = asyncio.create_task(runner.run())
    try:
        runner.received("fog", Inbound("fleet/revoked", acme.fleet.revoked.der, 1, True))
        assert runner.identity is not None
        assert runner.identity.fleet.revoked.number == 2
        await eventually(lambda: all((folder / name).exists() for name in ("revoked.pem", "newest.pem")), "it is kept")
        await eventually(lambda: told[-1:] == [2], "its broker is told")
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
    assert Identity.load(folder).fleet.revoked.number == 2


async def test_a_renewed_key_is_taken_at_a_reload(acme: Authority, caplog: pytest.LogCaptureFixture) -> None:
    folder = acme.issue("drone1")
    runner = runner_of(Identity.load(folder))
    assert runner.identity is not None
    before = runner.identity.certificate
    acme.renew("drone1")
    caplog.set_level(logging.INFO, "mqttxt")
    await runner.reload()
    assert "drone1 signs with its new key" in caplog.text
    renewed = runner.identity.certificate
    assert renewed != before
    renewed.public_key.verify(runner.identity.sign(b"x"), b"x")
    (folder / "identity.pem").write_bytes((acme.folder / "drone1~" / "identity.pem").read_bytes())
    await runner.reload()
    assert f"{folder}/identity.pem: not the key of certificate.pem (drone1)" in caplog.text
    assert runner.identity.certificate == renewed


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
        await eventually(lambda: "the certificate of gs-ops is expired" in caplog.text, "it says so")
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


async def test_no_broker_reads_a_list_that_would_let_everybody_in(
    acme: Authority, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bad file is put right before Mosquitto is told; where the disk does not take that, it is not told."""
    files = BrokerFiles(acme.issue("broker-fog1"))
    bad = files.identity.folder / "revoked.pem"
    bad.write_bytes(b"garbage")
    with pytest.raises(ConfigurationError, match=r"revoked.pem: not a certificate revocation list"):
        files.write_access(tmp_path)
    assert bad.read_bytes() == files.identity.fleet.revoked.pem()
    assert files.is_list_readable
    bad.write_bytes(b"garbage")

    def full(*_: object, **__: object) -> None:
        raise ConfigurationError("No space left on device")

    monkeypatch.setattr("mqttxt.security.files.write", full)
    with pytest.raises(ConfigurationError, match="No space left on device"):
        files.write_access(tmp_path)
    assert not files.is_list_readable


def test_a_renewed_nodes_entry_outlives_its_old_certificate_only_with_the_new_members(tmp_path: Path) -> None:
    """What docs/security.md says of a broker that was not brought its new members.pem after a renewal."""
    fleet = Authority.create(tmp_path / "acme", "acme")
    fleet.issue("fog1", days=1)
    broker = fleet.issue("broker-cloud")
    elsewhere = Path(shutil.copytree(broker, tmp_path / "elsewhere"))
    fleet.renew("fog1", days=9)

    def has_entry(days: float) -> bool:
        files = BrokerFiles(elsewhere, system=lambda: time.time() + days * 86_400)
        files.write_access(tmp_path)
        return "\nuser fog1\n" in f"\n{(tmp_path / ACCESS_FILE).read_text()}"

    assert has_entry(0)
    assert not has_entry(2)
    shutil.copyfile(broker / "members.pem", elsewhere / "members.pem")
    assert has_entry(2)
    assert not has_entry(10)


@pytest.mark.long
@pytest.mark.parametrize("cuts", [True, False])
async def test_a_broker_is_started_anew_where_a_revoked_certificates_name_stays_in_use(
    acme: Authority, tmp_path: Path, cuts: bool
) -> None:
    """SIGHUP cuts no connection, and the name's entry stays: the old key would go on under it."""
    folder = acme.issue("broker-fog1")
    for name in ("drone1", "drone2"):
        acme.issue(name)
    lives, program = tmp_path / "lives", tmp_path / "mosquitto"
    running_line = "echo '1: mosquitto version 2.0.21 running' >&2"
    program.write_text(f"#!/bin/sh\ntrap '' HUP\necho life >> {lives}\n{running_line}\nexec sleep 600\n")
    program.chmod(0o755)
    broker = EmbeddedBroker("127.0.0.1", 18832, program=str(program), files=BrokerFiles(folder), cuts=cuts)
    running = asyncio.create_task(broker.run())

    async def begun() -> int:
        await asyncio.sleep(1.0)
        return lives.read_text().count("life")

    try:
        await eventually(lambda: lives.exists() and lives.read_text() != "", "the broker starts")
        before = (folder / "members.pem").read_bytes()
        acme.revoke("drone2")
        await asyncio.to_thread(broker.reload, acme.fleet.revoked)
        assert await begun() == 1, "who has no entry is silent"
        acme.renew("drone1")
        acme.revoke("drone1", only_old=True)
        renewed = (folder / "members.pem").read_bytes()
        (folder / "members.pem").write_bytes(before)
        await asyncio.to_thread(broker.reload, acme.fleet.revoked)
        assert await begun() == 1, "the name has no entry until the new certificate is there"
        (folder / "members.pem").write_bytes(renewed)
        for _ in range(2):
            await asyncio.to_thread(broker.reload, acme.fleet.revoked)
            assert await begun() == (2 if cuts else 1)
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)


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
        await eventually(lambda: (tmp_path / "seen.conf").exists(), "the broker starts")
        text = (tmp_path / "seen.conf").read_text()
        assert "listener 18831 127.0.0.1\nmax_connections 2000\n" in text
        assert "\nallow_anonymous false\nrequire_certificate true\n" in text
        access = Path(text.rpartition("acl_file ")[2].strip())
        assert "user drone1\n" in access.read_text()
        acme.revoke("drone1")
        await asyncio.to_thread(broker.reload)
        assert "user drone1\n" not in access.read_text()
        await eventually(lambda: (tmp_path / "said").exists(), "the broker is told")
        assert "user fog1\n" in access.read_text()
        given, lists = acme.fleet.revoked, [folder / "revoked.pem", folder / "newest.pem"]
        acme.revoke("fog1")
        for each in lists:
            each.write_bytes(given.pem())
        await asyncio.to_thread(broker.reload, acme.fleet.revoked)
        assert "user fog1\n" not in access.read_text()
        assert [each.read_bytes() for each in lists] == [acme.fleet.revoked.pem()] * 2
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
    assert not access.exists()
