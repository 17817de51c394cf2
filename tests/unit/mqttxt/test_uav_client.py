"""The UAV client: what it executes, refuses, answers and tells of itself (sections 3, 4, 5 and 9)."""

from __future__ import annotations

from typing import Any

import cbor2
import pytest

from mqttxt.activator.drones import CLOUD, FOG
from mqttxt.core.effects import Audit, Inbound, Log, Publish, Stop, Subscribe
from mqttxt.core.settings import Settings
from mqttxt.drone.answers import Unfinished
from mqttxt.drone.effects import Journal, Transmit
from mqttxt.drone.role import UavClient
from mqttxt.protocol.codec import decode, encode
from mqttxt.protocol.commands import Arm, Disarm, Hold, Land, Return
from mqttxt.protocol.control import DroneLease
from mqttxt.protocol.messages import BeaconMessage, CommandId, Presence, Word
from tests.simulation.world import (
    GS_SESSION,
    UAV_SESSION,
    World,
    ack,
    command_payload,
    connect,
    heartbeat,
    on_disk,
    on_the_ground,
    ready,
    results,
    transmitted,
)

ARM = 400


def client(qos: int = 1, unfinished: list[Unfinished] | None = None, now_ms: int = 1000) -> UavClient:
    made = UavClient(1, UAV_SESSION, Settings(qos=qos), unfinished=unfinished)
    ready(made, now_ms)
    return made


@pytest.fixture
def uav() -> UavClient:
    return client()


def hear(uav: UavClient, message: Any, now_ms: int = 1000, retain: bool = False) -> list[Any]:
    return on_disk(uav, uav.on_message("fog", Inbound("drone1/commands", encode(message), 1, retain), now_ms), now_ms)


def words(effects: list[Any]) -> list[tuple[Word, str | None]]:
    return [(result.word, result.reason) for result in results(effects)]


def states_of(effects: list[Any]) -> list[str]:
    return [e.topic for e in effects if isinstance(e, Publish) and "/state/" in e.topic]


def published(effects: list[Any], topic: str) -> list[Publish]:
    return [e for e in effects if isinstance(e, Publish) and e.topic == topic]


def lease(uav: UavClient, now_ms: int, **changed: Any) -> list[Any]:
    """What the client does with a lease of its activator."""
    fields = {"activator_session": 9, "drone_session": UAV_SESSION, "nonce": 42, "bound": True, **changed}
    return list(uav.on_message("fog", Inbound("drone1/init_connect", encode(DroneLease(**fields)), 1), now_ms))


def test_commands_are_subscribed_without_what_is_retained() -> None:
    uav = UavClient(1, UAV_SESSION, Settings())
    commands, others = uav.on_connected("fog", 0)
    assert commands == Subscribe("fog", ("drone1/commands",), live_only=True)
    assert isinstance(others, Subscribe)
    assert others.filters == ("drone1/init_connect", "drone1/reachable", "drone1/bulk")
    assert uav.on_subscribed(commands, 0) == []
    birth, beacon = uav.on_subscribed(others, 0)
    assert isinstance(birth, Publish)
    assert (birth.retain, birth.qos) == (True, 1)
    assert decode(Presence, birth.payload) == Presence(session=UAV_SESSION, up=True)
    assert isinstance(beacon, Publish)
    assert decode(BeaconMessage, beacon.payload).session == UAV_SESSION


def test_a_command_is_journaled_before_its_first_write() -> None:
    effects = hear(client(), command_payload(Arm()))
    kinds = [type(effect) for effect in effects]
    assert kinds.index(Journal) < kinds.index(Transmit)
    assert effects[kinds.index(Transmit)].not_after_ms == 5000


@pytest.mark.parametrize(
    ("changed", "retained", "word", "reason"),
    [
        ({}, True, Word.DENIED, "retained"),
        ({"deadline_ms": None}, False, Word.DENIED, "no_deadline"),
        ({"executor_session": 99}, False, Word.DENIED, "no_deadline"),
        ({"deadline_ms": 999}, False, Word.EXPIRED, None),
        ({"deadline_ms": 0}, False, Word.EXPIRED, None),
        ({"deadline_ms": 61_001}, False, Word.DENIED, "deadline_too_far"),
    ],
)
def test_what_is_not_executed(changed: dict[str, Any], retained: bool, word: Word, reason: str | None) -> None:
    uav = client()
    effects = hear(uav, command_payload(Arm(), **changed), retain=retained)
    assert words(effects) == [(word, reason)]
    assert transmitted(effects) == []
    assert words(hear(uav, command_payload(Arm(), **changed), retain=retained)) == [(word, reason)]


def test_the_last_millisecond_of_the_deadline_is_still_in_time() -> None:
    assert len(transmitted(hear(client(), command_payload(Arm(), deadline_ms=1000)))) == 1


def test_an_unknown_session_is_told_this_ones_beacon() -> None:
    (result,) = results(hear(client(), command_payload(Arm(), executor_session=99), now_ms=1234))
    assert result.beacon == BeaconMessage(session=UAV_SESSION, now_ms=1234)


def test_a_duplicate_is_answered_and_not_executed(uav: UavClient) -> None:
    hear(uav, command_payload(Arm()))
    assert transmitted(hear(uav, command_payload(Arm()))) == []
    uav.on_mavlink(ack(ARM), 1100)
    again = hear(uav, command_payload(Arm()), 1200)
    assert words(again) == [(Word.ACCEPTED, None)]
    assert transmitted(again) == []
    uav.on_mavlink(heartbeat(armed=True), 1300)
    assert words(hear(uav, command_payload(Arm(), deadline_ms=0), 90_000)) == [(Word.COMPLETED, None)]


def test_one_id_with_other_contents_is_denied_and_the_first_goes_on(uav: UavClient) -> None:
    hear(uav, command_payload(Arm()))
    conflict = hear(uav, command_payload(Disarm()))
    assert words(conflict) == [(Word.DENIED, "id_conflict")]
    assert all(e.ref is None for e in conflict if isinstance(e, Publish))
    assert words(list(uav.on_mavlink(ack(ARM), 1100))) == [(Word.ACCEPTED, None)]


def test_a_lower_number_is_overtaken_by_a_started_one_of_its_session(uav: UavClient) -> None:
    hear(uav, command_payload(Hold(), seq=5))
    assert words(hear(uav, command_payload(Arm(), seq=4))) == [(Word.OVERTAKEN, None)]
    assert len(transmitted(hear(uav, command_payload(Arm(), seq=4, gs_session=0x77)))) == 1


@pytest.mark.parametrize("why", [{"deadline_ms": 1}, {"deadline_ms": 0}, {"deadline_ms": 61_001}])
def test_behind_a_hold_that_was_denied_only_what_stops_the_drone_is_started(
    uav: UavClient, why: dict[str, int]
) -> None:
    """An older command may come late over another connection (R19.4)."""
    assert transmitted(hear(uav, command_payload(Hold(), seq=5, **why))) == []
    assert words(hear(uav, command_payload(Arm(), seq=4))) == [(Word.OVERTAKEN, None)]
    assert len(transmitted(hear(uav, command_payload(Disarm(), seq=3)))) == 1
    assert len(transmitted(hear(uav, command_payload(Land(), seq=6)))) == 1


def test_another_command_that_was_denied_overtakes_nothing(uav: UavClient) -> None:
    hear(uav, command_payload(Arm(), seq=5, deadline_ms=1))
    assert len(transmitted(hear(uav, command_payload(Arm(), seq=4)))) == 1


def test_an_older_hold_does_not_let_through_what_a_newer_one_has_overtaken(uav: UavClient) -> None:
    hear(uav, command_payload(Hold(), seq=5, deadline_ms=1))
    hear(uav, command_payload(Hold(), seq=3, deadline_ms=1))
    assert words(hear(uav, command_payload(Arm(), seq=4))) == [(Word.OVERTAKEN, None)]


def test_a_malformed_command_is_denied_where_it_can_be_named() -> None:
    broken = cbor2.dumps([1, 0x11, 1, UAV_SESSION, 5000, 600, 0, 99])
    effects = list(client().on_message("fog", Inbound("drone1/commands", broken), 1000))
    assert words(effects) == [(Word.DENIED, "command: expected a known command, got 99")]
    assert [type(e) for e in client().on_message("fog", Inbound("drone1/commands", b"\xff"), 1000)] == [Log]


def controlled() -> UavClient:
    """A client whose drone the station of `command_payload` controls."""
    uav = client()
    lease(uav, 1000, deadline_ms=60_000, holder_session=0x11)
    return uav


def test_whoever_is_not_in_control_leaves_room_for_who_is() -> None:
    """Thousands of commands that nobody relayed are neither started nor in the way."""
    uav = controlled()
    uav.desk.ledger._capacity = 800
    for seq in range(900):
        hear(uav, command_payload(Land(), gs_session=0x77, seq=seq, deadline_ms=0))
    for seq in range(300):
        hear(uav, command_payload(Arm(), seq=seq, deadline_ms=0))
    denied = hear(uav, command_payload(Arm(), seq=9000))
    assert (words(denied), transmitted(denied)) == ([(Word.DENIED, "ledger_full")], [])
    for seq, command in ((9001, Hold()), (9002, Land()), (9003, Return())):
        assert len(transmitted(hear(uav, command_payload(command, seq=seq)))) == 1


def test_many_who_are_not_in_control_leave_room_for_who_is() -> None:
    uav = controlled()
    uav.desk.ledger._capacity = 800
    out = [hear(uav, command_payload(Land(), gs_session=0x1000 + number, deadline_ms=0)) for number in range(900)]
    assert any(isinstance(effect, Log) and "no room for it" in effect.detail for effects in out for effect in effects)
    assert len(transmitted(hear(uav, command_payload(Land(), seq=9001)))) == 1


HOUR_MS = 3_600_000


def test_a_denied_command_is_not_executed_when_it_comes_again_after_the_ledger_has_dropped_it(uav: UavClient) -> None:
    far = command_payload(Arm(), deadline_ms=HOUR_MS)
    assert words(hear(uav, far)) == [(Word.DENIED, "deadline_too_far")]
    again_ms = HOUR_MS - 1000
    ready(uav, again_ms)
    hear(uav, command_payload(Hold(), gs_session=0x77), again_ms)
    again = hear(uav, far, again_ms)
    assert (words(again), transmitted(again)) == ([(Word.UNCONFIRMED, None)], [])
    later = command_payload(Arm(), seq=2, deadline_ms=again_ms + 5000)
    assert len(transmitted(hear(uav, later, again_ms))) == 1


def test_a_full_ledger_does_not_deny_what_may_still_be_in_time_when_it_has_room() -> None:
    uav = controlled()
    uav.desk.ledger._capacity = 0
    effects = hear(uav, command_payload(Arm(), deadline_ms=HOUR_MS))
    assert [type(effect) for effect in effects] == [Log]


def test_another_drones_topic_is_not_listened_to() -> None:
    (log,) = client().on_message("fog", Inbound("drone2/commands", encode(command_payload(Arm()))), 1000)
    assert isinstance(log, Log)


def test_a_last_word_stays_in_the_journal_until_it_is_acknowledged(uav: UavClient) -> None:
    hear(uav, command_payload(Arm()))
    (accepted,) = [e for e in uav.on_mavlink(ack(ARM), 1100) if isinstance(e, Publish)]
    assert accepted.ref is None
    effects = [e for e in uav.on_mavlink(heartbeat(armed=True), 1200) if not isinstance(e, Audit)]
    assert [type(e) for e in effects] == [Journal, Publish]
    ref = effects[1].ref
    assert ref == CommandId(0x11, 1)
    assert uav.on_published("fog", ref, 0x10, 1300) == []
    assert words(list(uav.tick(2400))) == [(Word.COMPLETED, None)]
    assert uav.on_published("fog", ref, 0, 2500) == [Journal(ref, "arm", done=True)]
    assert uav.on_published("fog", ref, 0, 2600) == []


def test_a_word_said_while_disconnected_is_published_after_the_next_birth(uav: UavClient) -> None:
    hear(uav, command_payload(Arm()))
    uav.on_disconnected("fog", 1050)
    assert words(list(uav.on_mavlink(ack(ARM), 1100))) == []
    uav.on_mavlink(heartbeat(armed=True), 1200)
    assert words(connect(uav, 1300)) == [(Word.COMPLETED, None)]


def test_what_an_earlier_session_left_open_is_unconfirmed() -> None:
    left = [Unfinished(CommandId(0x11, 1), "arm"), Unfinished(CommandId(0x11, 2), "hold", Word.COMPLETED)]
    uav = UavClient(1, UAV_SESSION, Settings(), unfinished=left)
    assert words(connect(uav, 0)) == [(Word.UNCONFIRMED, "restarted"), (Word.COMPLETED, None)]
    again = hear(uav, command_payload(Arm(), deadline_ms=0), 10)
    assert words(again) == [(Word.UNCONFIRMED, "restarted")]
    assert transmitted(again) == []


def test_an_id_of_an_earlier_session_is_never_expired_however_late_the_fog_is_found() -> None:
    uav = UavClient(1, UAV_SESSION, Settings(), unfinished=[Unfinished(CommandId(GS_SESSION, 7), "land")])
    for message in on_the_ground():
        uav.on_mavlink(message, 700_000)
    first, second = [one for one in uav.on_connected("fog", 700_000) if isinstance(one, Subscribe)]
    uav.on_subscribed(first, 700_001)
    hear(uav, command_payload(Hold(), seq=8, deadline_ms=705_000), 700_002)
    assert words(uav.on_subscribed(second, 700_003))[:1] == [(Word.UNCONFIRMED, "restarted")]
    assert words(hear(uav, command_payload(Land(), seq=7, deadline_ms=0), 702_000)) == [(Word.UNCONFIRMED, "restarted")]


def test_a_query_for_what_the_ledger_has_forgotten_is_not_denied(uav: UavClient) -> None:
    """A mission may fly for hours, and its station ask for it after long, through a new activator."""
    hear(uav, command_payload(Arm(), seq=7))
    for message in (ack(ARM), heartbeat(armed=True)):
        effects = uav.on_mavlink(message, 1010)
    assert words(effects) == [(Word.COMPLETED, None)]
    later = hear(uav, command_payload(Land(), seq=8, deadline_ms=0), 700_000)
    again = hear(uav, command_payload(Arm(), seq=7, deadline_ms=0), 700_010)
    assert (words(later), words(again)) == ([(Word.EXPIRED, None)], [(Word.UNCONFIRMED, None)])


def test_a_command_that_waited_for_the_disk_is_judged_again(uav: UavClient) -> None:
    for seq in (5, 4):
        uav.on_message("fog", Inbound("drone1/commands", encode(command_payload(Arm(), seq=seq))), 1000)
    uav.desk.on_journalled(CommandId(GS_SESSION, 5), 1800)
    assert words(uav.desk.on_journalled(CommandId(GS_SESSION, 4), 1900)) == [(Word.OVERTAKEN, None)]
    uav.on_message("fog", Inbound("drone1/commands", encode(command_payload(Arm(), seq=6, epoch=0))), 2000)
    uav.desk.holder.epoch = 1
    assert words(uav.desk.on_journalled(CommandId(GS_SESSION, 6), 2100)) == [(Word.DENIED, "not_in_control")]


def test_nothing_is_begun_after_a_clean_stop(uav: UavClient) -> None:
    uav.on_message("fog", Inbound("drone1/commands", encode(command_payload(Arm(), seq=5))), 1000)
    uav.goodbye(1100)
    assert uav.desk.on_journalled(CommandId(GS_SESSION, 5), 1200) == []
    assert hear(uav, command_payload(Arm(), seq=6), 1200) == []


def test_a_question_of_the_activator_is_echoed_at_once(uav: UavClient) -> None:
    (beacon,) = lease(uav, 1500)
    assert isinstance(beacon, Publish)
    assert decode(BeaconMessage, beacon.payload) == BeaconMessage(session=UAV_SESSION, now_ms=1500, nonce=42, held_ms=0)


def test_a_second_client_of_a_number_stops_when_it_is_refused() -> None:
    (stop,) = lease(client(), 1500, bound=False)
    assert isinstance(stop, Stop)
    assert lease(client(), 1500, bound=False, drone_session=77) == []


@pytest.mark.parametrize("seen", [Presence(session=77, up=False), Presence(session=UAV_SESSION, up=False)])
def test_a_late_will_is_answered_with_a_new_birth(uav: UavClient, seen: Presence) -> None:
    uav.on_message("fog", Inbound("drone1/reachable", encode(seen), retain=True), 1100)
    (birth,) = published(list(uav.tick(2100)), "drone1/reachable")
    assert decode(Presence, birth.payload) == Presence(session=UAV_SESSION, up=True)
    assert birth.retain


def test_a_forged_will_again_and_again_does_not_put_the_birth_off() -> None:
    uav, births = client(), 0
    forged = Inbound("drone1/reachable", encode(Presence(session=UAV_SESSION, up=False)), retain=True)
    for now_ms in range(2000, 12_000, 100):
        if now_ms % 800 == 0:
            uav.on_message("fog", forged, now_ms)
        births += len(published(list(uav.tick(now_ms)), "drone1/reachable"))
    assert 5 <= births <= 10


def test_the_own_birth_needs_no_answer(uav: UavClient) -> None:
    uav.on_message(
        "fog", Inbound("drone1/reachable", encode(Presence(session=UAV_SESSION, up=True)), retain=True), 1100
    )
    assert published(list(uav.tick(2500)), "drone1/reachable") == []


def test_beacons_come_every_ten_seconds_and_heartbeats_every_second() -> None:
    uav = client(now_ms=0)
    effects = [e for now in range(100, 30_001, 100) for e in uav.tick(now)]
    assert len(published(effects, "drone1/clock")) == 3
    beats = [e for e in effects if isinstance(e, Transmit) and e.message.get_type() == "HEARTBEAT"]
    assert len(beats) == 30
    assert beats[0].message.type == 18
    assert all(beat.ref is None for beat in beats)


def test_a_clean_stop_says_that_the_drone_is_gone(uav: UavClient) -> None:
    (down,) = uav.goodbye(2000)
    assert isinstance(down, Publish)
    assert (
        decode(Presence, down.payload)
        == Presence(session=UAV_SESSION, up=False)
        == decode(Presence, uav.will().payload)
    )


def test_at_qos_0_results_leave_the_journal_when_they_are_said() -> None:
    uav = client(qos=0)
    hear(uav, command_payload(Arm()))
    uav.on_mavlink(ack(ARM), 1100)
    effects = list(uav.on_mavlink(heartbeat(armed=True), 1200))
    assert [e.done for e in effects if isinstance(e, Journal)] == [False, True]
    assert {e.qos for e in effects if isinstance(e, Publish)} == {0}


def test_states_are_published_once_and_again_after_a_reconnection(uav: UavClient) -> None:
    first = [e.topic for e in uav.tick(1100) if isinstance(e, Publish) and "/state/" in e.topic]
    assert "drone1/state/armed" in first
    assert [e for e in uav.tick(1200) if isinstance(e, Publish) and "/state/" in e.topic] == []
    uav.on_disconnected("fog", 1300)
    connect(uav, 1400)
    again = [e.topic for e in uav.tick(1500) if isinstance(e, Publish) and "/state/" in e.topic]
    assert again == first


@pytest.mark.parametrize("asked", [{"deadline_ms": 0}, {"executor_session": 99}])
@pytest.mark.parametrize("remembers", [True, False])
def test_without_a_journal_nobody_knows_what_an_earlier_session_did(asked: dict[str, int], remembers: bool) -> None:
    client = UavClient(1, UAV_SESSION, Settings(), remembers=remembers)
    ready(client)
    payload = encode(command_payload(Arm(), **asked))
    (said,) = results(client.on_message("fog", Inbound("drone1/commands", payload, 1), 100))
    if remembers:
        assert said.word in (Word.EXPIRED, Word.DENIED)
    else:
        assert (said.word, said.reason) == (Word.UNCONFIRMED, "no_journal")


@pytest.mark.parametrize("asked", [{"deadline_ms": 0}, {"executor_session": 99}])
def test_of_an_id_that_the_journal_may_have_dropped_nobody_knows_what_became(asked: dict[str, int]) -> None:
    client = UavClient(1, UAV_SESSION, Settings(), forgotten=[CommandId(GS_SESSION, 7)])
    ready(client)
    said = [words(hear(client, command_payload(Arm(), seq=seq, **asked), 100)) for seq in (6, 7, 8)]
    assert said[:2] == [[(Word.UNCONFIRMED, None)]] * 2
    assert said[2][0][0] in (Word.EXPIRED, Word.DENIED)


def test_a_new_activator_session_hears_every_state_anew(uav: UavClient) -> None:
    told = states_of(uav.tick(1100))
    assert told
    for session, begin_ms in ((5, 1200), (6, 4000)):
        for nonce in (1, 2):
            lease(uav, begin_ms + 900 * nonce, activator_session=session, nonce=nonce)
            again = [topic for tenth in range(9) for topic in states_of(uav.tick(begin_ms + 900 * nonce + 100 * tenth))]
            assert sorted(again) == (sorted(told) if nonce == 1 else [])


def test_a_lease_is_no_reason_to_publish_faster_than_a_states_rate(uav: UavClient) -> None:
    told = states_of(uav.tick(1100))
    lease(uav, 1150)
    assert "drone1/state/location" not in states_of(uav.tick(2000))
    assert "drone1/state/location" in {*told} & {*states_of(uav.tick(2100))}


def test_an_activator_that_comes_after_its_drones_gets_their_states_at_once() -> None:
    world = World(qos=0)
    world.gs.add_fogs([1])
    for message in on_the_ground():
        world.uav.on_mavlink(message, 0)
    world.run("uav", world.uav.on_connected(FOG, 0))
    world.pass_time(1000)
    world.run("activator", world.activator.on_connected(CLOUD, world.now_ms))
    world.run("gs", world.gs.on_connected(CLOUD, world.now_ms))
    world.run("activator", world.activator.on_connected(FOG, world.now_ms))
    world.pass_time(2000)
    assert {"location", "home", "armed", "landed_state"} <= set(world.gs.fogs[1].drones[1].states)


def test_a_restarted_client_answers_what_it_was_told_of_an_earlier_session_and_says_it_only_when_asked() -> None:
    told = Unfinished(CommandId(0x11, 1), "arm", Word.COMPLETED, delivered=True)
    uav = UavClient(1, UAV_SESSION, Settings(), unfinished=[told])
    ready(uav, 1000)
    assert words(uav.tick(1100)) == []
    asked = hear(uav, command_payload(Arm(), executor_session=UAV_SESSION, deadline_ms=0))
    assert words(asked) == [(Word.COMPLETED, None)]
