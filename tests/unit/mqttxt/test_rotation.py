"""Keys renewed and revoked in flight, where messages are signed: no command is lost, and nobody revoked is heard."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from mqttxt.core.effects import Publish
from mqttxt.protocol.codec import decode
from mqttxt.protocol.commands import Arm, Hold, Offboard, Velocity
from mqttxt.protocol.messages import BeaconMessage, FogPresence, Presence, Word
from mqttxt.security.authority import Authority
from mqttxt.security.cose import Envelope
from mqttxt.security.identity import Identity
from mqttxt.security.rights import Rights
from mqttxt.security.seal import Seal
from mqttxt.station.list_watch import BEHIND_MS
from mqttxt.station.outcomes import ListBehind, Outcome
from tests.simulation.signing import ALL
from tests.simulation.world import World, ack, heartbeat, landed, position

NODES = {"gs-g": "gs", "fog1": "activator", "drone1": "uav"}


class Fleet:
    """A fleet that flies, and its authority."""

    def __init__(self, folder: Path) -> None:
        self.acme = Authority.create(folder / "acme", "acme")
        self.acme.issue("gs-two", ALL)
        self.seals = {
            name: Seal(Identity.load(self.acme.issue(name, ALL if name == "gs-g" else Rights()))) for name in NODES
        }
        self.world = World(signed=True, seal=self.seals.get).start()
        self.world.pass_time(1000)
        self.world.heard.clear()
        self.world.logs.clear()

    def renew(self, name: str) -> None:
        """A new key, at SIGHUP."""
        self.acme.renew(name)
        identity = self.seals[name].identity
        assert identity.renew(*identity.in_folder())
        self._say(name)

    def take_list(self, *names: str) -> None:
        """The newest list has come to these nodes."""
        for name in names:
            assert self.seals[name].identity.fleet.take(self.acme.fleet.revoked)
            self._say(name)

    def _say(self, name: str) -> None:
        role = getattr(self.world, NODES[name])
        self.world.run(NODES[name], role.on_identity(self.world.now_ms))

    def last_words(self) -> list[tuple[Word, str | None]]:
        return [(o.word, o.reason) for o in self.world.heard if isinstance(o, Outcome) and o.is_last]


@pytest.fixture
def fleet(tmp_path: Path) -> Fleet:
    return Fleet(tmp_path)


def test_renewals_and_the_revocation_of_the_old_keys_lose_no_command(fleet: Fleet) -> None:
    world, sent = fleet.world, 0
    steps: dict[int, Any] = {5 * at: name for at, name in enumerate(NODES, 1)}
    revoked_at = 5 * (len(NODES) + 1)
    for turn in range(40):
        if turn in steps:
            fleet.renew(steps[turn])
        if turn == revoked_at:
            for name in NODES:
                assert fleet.acme.revoke(name, only_old=True) == 1
        if revoked_at <= turn < revoked_at + 3:
            fleet.take_list(list(NODES)[turn - revoked_at])  # at each node in its own time
        world.send(Arm())
        sent += 1
        world.autopilot(ack(400), heartbeat(armed=True))
        world.pass_time(500)
    assert fleet.last_words() == [(Word.COMPLETED, None)] * sent
    assert world.logs == []


def test_who_comes_after_a_renewal_meets_the_new_keys(fleet: Fleet) -> None:
    for name in NODES:
        fleet.renew(name)
        fleet.acme.revoke(name, only_old=True)
    fleet.take_list(*NODES)
    fleet.seals["drone1"] = Seal(Identity.load(fleet.acme.folder / "drone1"))
    fleet.world.restart_uav(0x98, [])
    fleet.seals["fog1"] = Seal(Identity.load(fleet.acme.folder / "fog1"))
    fleet.world.restart_activator(0x99)
    fleet.world.pass_time(6000)
    fleet.world.send(Arm())
    assert len(fleet.world.wrote) == 1


def test_what_is_open_is_asked_for_by_the_new_key(fleet: Fleet) -> None:
    """Its words were lost, and the old key is revoked before the station asks again."""
    world = fleet.world
    world.drop = {"arm"}
    world.send(Arm())
    world.autopilot(ack(400), heartbeat(armed=True))
    fleet.renew("gs-g")
    fleet.acme.revoke("gs-g", only_old=True)
    fleet.take_list(*NODES)
    world.drop = set()
    world.pass_time(12_000)
    assert fleet.last_words() == [(Word.COMPLETED, None)]
    assert len(world.wrote) == 1


def test_a_key_that_cannot_be_used_changes_nothing(fleet: Fleet) -> None:
    before = fleet.seals["drone1"].certificate
    other = fleet.acme.issue("drone2")
    for file in ("identity.pem", "certificate.pem"):
        (fleet.acme.folder / "drone1" / file).write_bytes((other / file).read_bytes())
    identity = fleet.seals["drone1"].identity
    with pytest.raises(Exception, match="drone2; expected a certificate of drone1"):
        identity.in_folder()
    assert fleet.seals["drone1"].certificate == before


def test_a_revoked_station_is_not_heard_and_holds_nothing_any_more(fleet: Fleet) -> None:
    world = fleet.world
    world.autopilot(heartbeat(armed=True), landed(2), position(10.0))
    world.send(Offboard(60.0, velocity=Velocity(1.0, 0.0, 0.0)))
    world.pass_time(3000)
    assert world.activator.leases.controls(world.gs.session, 1)
    fleet.acme.revoke("gs-g")
    world.wrote.clear()
    fleet.take_list("fog1", "drone1")
    world.send(Hold())
    assert not world.activator.leases
    assert world.uav.desk.executor.lease.holder_session is None
    world.pass_time(100)
    assert not [each for each in world.wrote if getattr(each.message, "command", None) == 192]
    assert {log.kind for log in world.logs} == {"certificate"}


def numbers(fleet: Fleet) -> dict[str, list[int | None]]:
    """What was said of revocation lists, by topic."""
    kinds = {
        "drone1/clock": BeaconMessage,
        "drone1/reachable": Presence,
        "fog1/clock": BeaconMessage,
        "fog1/reachable": FogPresence,
        "gs/g/reachable": Presence,
    }
    return {
        topic: [
            decode(kind, Envelope.parse(publish.payload).payload).revoked
            for _, publish in fleet.world.sent
            if publish.topic == topic
        ]
        for topic, kind in kinds.items()
    }


def test_births_and_beacons_name_the_newest_list_at_once(fleet: Fleet) -> None:
    assert all(set(found) == {1} for found in numbers(fleet).values())
    fleet.acme.revoke("gs-two")
    fleet.take_list(*NODES)
    assert all(found[-1] == 2 for found in numbers(fleet).values())


def test_a_fleet_that_does_not_sign_says_nothing_of_lists() -> None:
    world = World().start()
    beacons = [publish for _, publish in world.sent if publish.topic.endswith("clock")]
    assert beacons
    assert all(decode(BeaconMessage, publish.payload).revoked is None for publish in beacons)
    assert list(world.uav.on_identity(0)) == list(world.activator.on_identity(0)) == list(world.gs.on_identity(0)) == []


def told(fleet: Fleet) -> list[tuple[str, int, int]]:
    return [(each.node, each.number, each.newest) for each in fleet.world.heard if isinstance(each, ListBehind)]


def test_who_goes_on_with_an_old_list_is_told_of_once(fleet: Fleet) -> None:
    fleet.acme.revoke("gs-two")
    fleet.take_list("gs-g", "fog1")
    fleet.world.pass_time(BEHIND_MS - 11_000)
    assert told(fleet) == []
    fleet.world.pass_time(60_000)
    assert told(fleet) == [("drone1", 1, 2)]
    fleet.take_list("drone1")
    fleet.acme.issue("gs-three")
    fleet.acme.revoke("gs-three")
    fleet.take_list("fog1", "drone1")
    fleet.world.pass_time(60_000)
    assert told(fleet) == [("drone1", 1, 2), ("gs-g", 2, 3)]


def test_a_list_on_its_way_is_no_alarm(fleet: Fleet) -> None:
    fleet.acme.revoke("gs-two")
    for name in NODES:
        fleet.take_list(name)
        fleet.world.pass_time(9000)
    fleet.world.pass_time(60_000)
    assert told(fleet) == []


def test_renewed_words_are_the_same_words(fleet: Fleet) -> None:
    """An activator's record from before its renewal is signed anew: who comes later knows the new key alone."""
    before = fleet.world.retained["cloud", "fog1/drone1/reachable"]
    fleet.renew("fog1")
    after = fleet.world.retained["cloud", "fog1/drone1/reachable"]
    assert isinstance(after, Publish)
    assert Envelope.parse(after.payload).payload == Envelope.parse(before.payload).payload
    assert Envelope.parse(after.payload).kid != Envelope.parse(before.payload).kid
