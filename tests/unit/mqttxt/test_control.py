"""Control from end to end: the station's registrations, the drone's lease, and the heartbeats by it (section 6)."""

from __future__ import annotations

from typing import Any

import pytest

from mqttxt.core.effects import Inbound, Publish
from mqttxt.core.settings import Settings
from mqttxt.drone.effects import Transmit
from mqttxt.drone.mavlink.sources import Source
from mqttxt.errors import ConfigurationError
from mqttxt.protocol.codec import decode, encode
from mqttxt.protocol.commands import Arm, Hold, Offboard, Velocity
from mqttxt.protocol.control import Control, DroneLease, DroneRecord, Registration
from mqttxt.protocol.messages import CommandMessage, Word
from mqttxt.station.outcomes import ControlChanged
from mqttxt.station.role import StationRole
from tests.simulation.fogs import UAV_AHEAD_MS, ActivatorBench, of, ready, words
from tests.simulation.world import GS_SESSION, UAV_SESSION, World, command_payload, results, transmitted
from tests.unit.mqttxt.test_ground_station import FOG, StationBench
from tests.unit.mqttxt.test_uav_client import client, hear, published


def record(effects: list[Any]) -> DroneRecord:
    return decode(DroneRecord, of(effects, "fog1/drone1/reachable")[-1].payload)


def lease(effects: list[Any]) -> DroneLease:
    return decode(DroneLease, of(effects, "drone1/init_connect")[-1].payload)


# The activator


def test_who_controls_a_drone_is_in_its_record_and_in_its_lease() -> None:
    bench = ready(controlled=False)
    effects = bench.register()
    shown = record(effects)
    assert (shown.holder, shown.holder_session, shown.epoch) == ("alpha", GS_SESSION, None)
    handed = lease(effects)
    assert handed.holder_session == GS_SESSION
    assert handed.deadline_ms is not None
    assert 0 <= bench.now_ms + UAV_AHEAD_MS + 30_000 - handed.deadline_ms <= 200


def test_a_station_without_control_is_told_who_has_it() -> None:
    bench = ready()
    bench.register(name="beta", session=9)
    assert words(bench.command(Arm(), gs_session=9, seq=1)) == [(Word.DENIED, "not_in_control, alpha")]
    assert words(bench.command(Arm(), seq=2)) == []


def test_a_takeover_is_announced_and_refuses_what_was_sent_before_it() -> None:
    bench = ready()
    effects = bench.register(name="beta", session=9, control=Control.TAKE)
    assert (record(effects).holder, record(effects).epoch) == ("beta", 1)
    assert (lease(effects).holder_session, lease(effects).epoch) == (9, 1)
    assert words(bench.command(Arm(), gs_session=9, epoch=0)) == [(Word.DENIED, "not_in_control, beta")]
    assert words(bench.command(Hold(), gs_session=9, seq=2, epoch=1)) == []


def test_a_drone_is_sent_no_epoch_that_only_an_earlier_activator_has_counted_to() -> None:
    """Its station has seen it in a record; a takeover in this session would have a lower one."""
    bench = ready()
    effects = bench.command(Arm(), epoch=7)
    assert decode(CommandMessage, of(effects, "drone1/commands")[-1].payload).epoch == 0
    bench.register(name="beta", session=9, control=Control.TAKE)
    effects = bench.command(Arm(), gs_session=9, epoch=7)
    assert decode(CommandMessage, of(effects, "drone1/commands")[-1].payload).epoch == 1


def test_the_end_of_a_lease_is_handed_down_at_once() -> None:
    bench = ready()
    effects = bench.register(lease_s=0)
    assert record(effects).holder is None
    assert lease(effects).deadline_ms is None


def test_a_short_lease_is_handed_down_more_often() -> None:
    bench = ready(controlled=False)
    bench.register(lease_s=6)
    assert len(of(bench.until(bench.now_ms + 3000), "drone1/init_connect")) >= 1


@pytest.mark.parametrize("by_wildcard", [True, False])
def test_a_new_activator_session_keeps_the_drone_for_its_station(by_wildcard: bool) -> None:
    """Also where the broker shows records by their full names alone."""
    bench = ActivatorBench(born=False)
    before = DroneRecord(activator_session=99, up=True, drone_session=5, holder="alpha", holder_session=17, epoch=3)
    if by_wildcard:
        bench.cloud("drone1/reachable", before, retain=True)
        bench.cloud("clock", own_beacon(bench))
    else:
        bench.be_shown((1, before))
    bench.appear()
    bench.register(name="beta", session=9)
    assert words(bench.command(Arm(), gs_session=9, epoch=3)) == [(Word.DENIED, "not_in_control")]
    bench.register(session=17)
    assert words(bench.command(Arm(), gs_session=17, epoch=3)) == []


def own_beacon(bench: ActivatorBench) -> Any:
    (publish,) = bench.beacons
    return publish.payload


def test_while_an_offboard_command_is_open_the_lease_is_handed_down_often_and_is_short() -> None:
    bench = ready(controlled=False)
    now_ms = bench.now_ms
    bench.register(until_ms=now_ms + 29_000)  # sent a second ago, for 30 s
    bench.command(Offboard(1.0, velocity=Velocity(1, 0, 0)))
    first = lease(bench.until(now_ms + 100))
    assert first.offboard_until_ms is not None
    assert 0 <= now_ms + UAV_AHEAD_MS + 2000 - first.offboard_until_ms <= 20
    assert len(of(bench.until(now_ms + 2000), "drone1/init_connect")) >= 3
    bench.result(Word.COMPLETED)
    assert of(bench.until(now_ms + 5000), "drone1/init_connect")[1:] == []


# The UAV client


def hand_down(uav: Any, now_ms: int = 1000, **fields: Any) -> list[Any]:
    given = {"activator_session": 5, "drone_session": UAV_SESSION, "nonce": 1, "bound": True, **fields}
    return list(uav.on_message("fog", Inbound("drone1/init_connect", encode(DroneLease(**given)), 1), now_ms))


def heartbeats(effects: list[Any]) -> list[tuple[int, Source]]:
    sent = [e for e in effects if isinstance(e, Transmit) and e.message.get_type() == "HEARTBEAT"]
    return [(e.message.type, e.source) for e in sent]


ONBOARD, GCS = (18, Source.COMPANION), (6, Source.GCS)


def test_a_uav_client_is_a_ground_station_to_its_autopilot_only_inside_the_lease() -> None:
    uav = client()
    assert heartbeats(uav.tick(1000)) == [ONBOARD]
    hand_down(uav, holder_session=7, deadline_ms=2500)
    assert heartbeats(uav.tick(2000)) == [ONBOARD, GCS]
    assert heartbeats(uav.tick(3000)) == [ONBOARD]
    hand_down(uav, 3000, holder_session=7, deadline_ms=9000)
    hand_down(uav, 3000)
    assert heartbeats(uav.tick(4000)) == [ONBOARD]


def test_a_command_of_a_lower_epoch_than_the_lease_is_refused() -> None:
    uav = client()
    hand_down(uav, epoch=2, holder_session=GS_SESSION, deadline_ms=9000)
    (publish,) = published(hear(uav, command_payload(Arm(), epoch=1)), "drone1/commands_result/arm")
    assert b"not_in_control" in publish.payload
    assert any(isinstance(e, Transmit) for e in hear(uav, command_payload(Arm(), seq=2, epoch=2)))


@pytest.mark.parametrize(
    ("sender", "epoch", "now_ms", "is_obeyed"),
    [
        pytest.param(GS_SESSION, 3, 2000, False, id="who had the drone before"),
        pytest.param(9, 3, 2000, True, id="the holder"),
        pytest.param(GS_SESSION, 4, 2000, True, id="a takeover whose lease has not come yet"),
        pytest.param(GS_SESSION, 3, 2001, True, id="a lease that has ended names nobody"),
    ],
)
def test_without_signatures_too_a_drone_obeys_no_station_that_another_has_followed(
    sender: int, epoch: int, now_ms: int, is_obeyed: bool
) -> None:
    """No takeover raised the epoch, and the command waited in the other one of two connections."""
    uav = client()
    hand_down(uav, epoch=3, counter=1, holder_session=GS_SESSION, deadline_ms=9000)
    hand_down(uav, epoch=3, counter=2, holder_session=9, deadline_ms=2000)
    effects = hear(uav, command_payload(Arm(), gs_session=sender, epoch=epoch), now_ms)
    assert bool(transmitted(effects)) is is_obeyed
    denials = [said.reason for said in results(effects) if said.word is Word.DENIED]
    assert denials == ([] if is_obeyed else ["not_in_control"])


def test_an_old_lease_of_the_same_activator_changes_nothing_and_a_new_activator_begins_anew() -> None:
    uav = client()
    hand_down(uav, epoch=2, holder_session=7, deadline_ms=9000)
    hand_down(uav, epoch=1, holder_session=6, deadline_ms=90_000)
    assert not uav.is_controlled(9001)
    hand_down(uav, epoch=0, activator_session=6, holder_session=GS_SESSION, deadline_ms=9500)
    assert uav.is_controlled(9400)
    assert any(isinstance(e, Transmit) for e in hear(uav, command_payload(Arm(), epoch=0)))


# The ground station


def record_of(holder_session: int | None = GS_SESSION, holder: str = "alpha", epoch: int | None = None) -> DroneRecord:
    """What the activator of the station's fog shows of a drone that this session controls, None: nobody."""
    name = None if holder_session is None else holder
    return DroneRecord(
        activator_session=FOG, up=True, drone_session=5, holder=name, holder_session=holder_session, epoch=epoch
    )


def registrations(effects: list[Any]) -> list[Registration]:
    return [decode(Registration, publish.payload) for publish in of(effects, "fog1/init_connect")]


def test_a_station_asks_for_control_and_a_watcher_does_not() -> None:
    bench = StationBench()
    (renewal,) = registrations(bench.until(20_100))
    assert (renewal.control, renewal.bundles) == (Control.WANT, False)
    assert renewal.until_ms is not None
    watcher = StationRole("w", 3, Settings(), control=False)
    watcher.add_fogs([1])
    assert watcher.fogs[1].registration(0).payload != b""
    assert decode(Registration, watcher.fogs[1].registration(0).payload).control is Control.NONE


def test_a_takeover_names_the_epoch_that_was_seen_and_is_asked_for_once() -> None:
    bench = StationBench()
    bench.hear("drone1/reachable", record_of(8, "x", epoch=4))
    (taken,) = registrations(bench.role.take_over(1, (1,), bench.now_ms))
    assert (taken.control, taken.epoch, taken.drones) == (Control.TAKE, 4, (1,))
    (renewal,) = registrations(bench.until(bench.now_ms + 10_100))
    assert (renewal.control, renewal.epoch, renewal.drones) == (Control.WANT, None, None)


def test_a_watcher_claims_single_drones_and_gives_them_up() -> None:
    bench = StationBench(control=False)
    (claimed,) = registrations(bench.role.claim(1, 2, True, bench.now_ms))
    assert (claimed.control, claimed.drones) == (Control.WANT, (2,))
    assert bench.role.claim(1, 2, True, bench.now_ms) == []
    bench.role.claim(1, 1, True, bench.now_ms)
    (taken,) = registrations(bench.role.take_over(1, (2,), bench.now_ms))
    assert (taken.control, taken.drones) == (Control.TAKE, (2,))
    (renewal,) = registrations(bench.until(bench.now_ms + 10_100))
    assert (renewal.control, renewal.drones) == (Control.WANT, (1, 2))
    for drone in (1, 2):
        (released,) = registrations(bench.role.claim(1, drone, False, bench.now_ms))
    assert (released.control, released.drones) == (Control.NONE, None)


def test_a_station_that_wants_all_claims_none() -> None:
    bench = StationBench()
    with pytest.raises(ConfigurationError, match="control=False"):
        bench.role.claim(1, 2, True, bench.now_ms)


def test_what_is_claimed_before_the_fog_is_there_is_registered_with_it() -> None:
    role = StationRole("w", 3, Settings(), control=False)
    role.add_fogs([1])
    assert role.claim(1, 2, True, 0) == []
    message = decode(Registration, role.fogs[1].registration(0).payload)
    assert (message.control, message.drones) == (Control.WANT, (2,))


@pytest.mark.parametrize("signed", [False, True])
def test_a_claimed_drone_is_controlled_until_it_is_released(signed: bool) -> None:
    world = World(signed=signed)
    world.gs = StationRole("g", GS_SESSION, world.settings, control=False, seal=world.gs._channel.seal)
    world.start()
    world.pass_time(11_000)
    assert not world.gs.fogs[1].controls(1)
    world.run("gs", world.gs.claim(1, 1, True, world.now_ms))
    assert world.gs.fogs[1].controls(1)
    world.pass_time(65_000)
    assert world.gs.fogs[1].controls(1)
    assert world.uav.is_controlled(world.now_ms)
    world.run("gs", world.gs.claim(1, 1, False, world.now_ms))
    assert not world.gs.fogs[1].controls(1)
    assert not world.uav.is_controlled(world.now_ms)


def given_up() -> StationBench:
    """A station that has given up drone 1 a moment ago: the activator's record still names it."""
    bench = StationBench(control=False)
    bench.confirm(bench.role.claim(1, 1, True, bench.now_ms))
    bench.hear("drone1/reachable", record_of())
    assert bench.role.fogs[1].controls(1)
    bench.role.claim(1, 1, False, bench.now_ms)
    return bench


def test_what_is_given_up_is_not_controlled_while_the_activators_word_is_older() -> None:
    bench = given_up()
    assert not bench.role.fogs[1].controls(1)
    bench.role.claim(1, 1, True, bench.now_ms)
    assert not bench.role.fogs[1].controls(1)
    bench.hear("drone1/reachable", record_of(None))
    assert not bench.role.fogs[1].controls(1)
    bench.hear("drone1/reachable", record_of())
    assert bench.role.fogs[1].controls(1)


def test_a_claim_anew_counts_once_it_is_answered_where_nothing_has_changed_for_the_activator() -> None:
    bench = given_up()
    bench.confirm(bench.role.claim(1, 1, True, bench.now_ms))
    assert bench.role.fogs[1].controls(1)


def test_the_answer_to_giving_up_is_not_that_to_a_claim() -> None:
    bench = StationBench(control=False)
    bench.confirm(bench.role.claim(1, 1, True, bench.now_ms))
    bench.hear("drone1/reachable", record_of())
    ended = bench.role.claim(1, 1, False, bench.now_ms)
    wanted = bench.role.claim(1, 1, True, bench.now_ms)
    bench.confirm(ended)
    assert not bench.role.fogs[1].controls(1)
    bench.confirm(wanted)
    assert bench.role.fogs[1].controls(1)


def test_commands_carry_the_newest_epoch_of_their_fog() -> None:
    bench = StationBench()
    (changed,) = bench.hear("drone1/reachable", record_of(epoch=4))
    assert changed == ControlChanged(1, 1, "alpha", True, 4)
    _, effects = bench.role.commands.send(bench.role.fog(1), 1, Arm(), bench.now_ms)
    (publish,) = [e for e in effects if isinstance(e, Publish)]
    assert decode(CommandMessage, publish.payload).epoch == 4


def test_a_station_with_an_open_offboard_command_renews_every_second() -> None:
    bench = StationBench()
    bench.hear("drone1/reachable", record_of())
    assert len(registrations(bench.until(bench.now_ms + 3000))) == 0
    offboard = Offboard(1.0, velocity=Velocity(1, 0, 0))
    bench.role.commands.send(bench.role.fog(1), 1, offboard, bench.now_ms)
    assert 3 <= len(registrations(bench.until(bench.now_ms + 3500))) <= 4
