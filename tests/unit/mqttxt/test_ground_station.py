"""The ground station: registrations, and exactly one last word (sections 4, 5 and 6); all roles together."""

from __future__ import annotations

from typing import Any

import pytest

from mqttxt.core.effects import Inbound, Publish, Subscribe
from mqttxt.core.ledger import KEEP_MS
from mqttxt.core.settings import Settings
from mqttxt.drone.answers import Unfinished
from mqttxt.errors import ConfigurationError, FogUnreachable
from mqttxt.protocol.codec import decode, encode
from mqttxt.protocol.commands import Arm, Command, Goto, Hold, Land, StartMission, Takeoff
from mqttxt.protocol.control import Control, DroneRecord, Registration
from mqttxt.protocol.messages import (
    BeaconMessage,
    CommandId,
    CommandMessage,
    FogPresence,
    FogResultMessage,
    Presence,
    ResultMessage,
    RosterEntry,
    Word,
)
from mqttxt.protocol.rankings import PsmiMessage, SelectMode
from mqttxt.station.outcomes import ControlChanged, Outcome, Reachability, StateUpdate
from mqttxt.station.role import StationRole
from tests.simulation.fogs import of
from tests.simulation.world import GS_SESSION, World, ack, heartbeat

ARM = 400
FOG = 0x22
OF_FOG: dict[str, Any] = {"gs_session": GS_SESSION, "seq": 1, "session": FOG, "stamp": 1}
"""What the activator says with its words about the first command."""


class StationBench:
    """A ground station whose fog is this test."""

    def __init__(self, qos: int = 1, registered: bool = True, control: Any = True, bundles: bool = False) -> None:
        self.role = StationRole("alpha", GS_SESSION, Settings(qos=qos, bundles=bundles), control=control)
        self.now_ms = 10_000
        self.role.add_fogs([1])
        self.subscribes = [e for e in self.role.on_connected("cloud", self.now_ms) if isinstance(e, Subscribe)]
        if registered:
            for subscribe in self.subscribes:
                self.role.on_subscribed(subscribe, self.now_ms)
            self.confirm(self.hear("reachable", FogPresence(session=FOG, up=True)))
            self.hear("drone1/reachable", DroneRecord(activator_session=FOG, up=True, drone_session=5))

    def hear(self, rest: str, message: Any) -> list[Any]:
        return list(self.role.on_message("cloud", Inbound(f"fog1/{rest}", encode(message), 1), self.now_ms))

    def confirm(self, effects: list[Any], session: int = FOG) -> list[Any]:
        (publish,) = of(effects, "fog1/init_connect")
        nonce = decode(Registration, publish.payload).nonce
        return self.hear("clock", BeaconMessage(session=session, now_ms=self.now_ms, nonce=nonce, held_ms=0))

    def until(self, now_ms: int) -> list[Any]:
        out: list[Any] = []
        while self.now_ms < now_ms:
            self.now_ms += 100
            out += self.role.tick(self.now_ms)
        return out

    def send(self, command: Any = None, drone: int | None = 1, **how: Any) -> Publish:
        _, (publish,) = self.role.commands.send(self.role.fog(1), drone, command or Arm(), self.now_ms, **how)
        assert isinstance(publish, Publish)
        return publish

    def result(self, word: Word, seq: int = 1, **changed: Any) -> list[Any]:
        message = ResultMessage(gs_session=GS_SESSION, seq=seq, session=5, stamp=1, word=word, **changed)
        return [(o.word, o.settled) for o in self.hear("drone1/commands_result/arm", message) if isinstance(o, Outcome)]


@pytest.fixture
def bench() -> StationBench:
    return StationBench()


def test_a_station_of_no_fog_says_nothing_of_itself() -> None:
    """One that only brings a revocation list: it may share its name with another session, in a fleet that signs."""
    role = StationRole("alpha", GS_SESSION, Settings())
    assert role.on_connected("cloud", 0) == role.tick(2000) == role.on_identity(2000) == role.goodbye(2000) == []
    own, fog = role.add_fogs([1])
    assert isinstance(own, Subscribe)
    assert own.filters == ("gs/alpha/reachable",)
    assert isinstance(fog, Subscribe)
    assert fog.ref == 1
    (birth,) = role.on_subscribed(own, 3000)
    assert isinstance(birth, Publish)
    assert decode(Presence, birth.payload) == Presence(session=GS_SESSION, up=True)
    (more,) = role.add_fogs([2])
    assert isinstance(more, Subscribe)
    assert more.ref == 2


def test_it_registers_after_the_suback_and_not_before() -> None:
    bench = StationBench(registered=False)
    own, fog = bench.subscribes
    assert of(bench.hear("reachable", FogPresence(session=FOG, up=True)), "fog1/init_connect") == []
    (publish,) = bench.role.on_subscribed(fog, bench.now_ms)
    registration = decode(Registration, publish.payload)  # type: ignore[union-attr]
    assert (registration.name, registration.session, registration.lease_s) == ("alpha", GS_SESSION, 30)
    (birth,) = bench.role.on_subscribed(own, bench.now_ms)
    assert decode(Presence, birth.payload).up  # type: ignore[union-attr]


def test_a_lease_is_renewed_at_a_third_and_at_each_activator_session(bench: StationBench) -> None:
    assert len(of(bench.until(30_000), "fog1/init_connect")) == 2
    assert len(of(bench.hear("reachable", FogPresence(session=99, up=True)), "fog1/init_connect")) == 1


def test_a_closed_mission_keeps_no_command_behind_it(bench: StationBench) -> None:
    """It might have lasted four hours, and was superseded at once."""
    bench.send(StartMission(b"m" * 16))
    bench.result(Word.SUPERSEDED)
    bench.until(11_000)
    for seq in range(2, 12):
        bench.send(Hold())
        bench.result(Word.COMPLETED, seq)
    bench.until(12_000)
    assert len(bench.role.commands.pending) == 11
    bench.now_ms += KEEP_MS + 300_000
    bench.role.tick(bench.now_ms)
    assert [one.command.name for one in bench.role.commands.pending.values()] == ["start_mission"]
    bench.now_ms += 4 * 3_600_000
    bench.role.tick(bench.now_ms)
    assert bench.role.commands.pending == {}


def test_without_a_confirmed_registration_or_beacons_nothing_is_sent() -> None:
    with pytest.raises(FogUnreachable):
        StationBench(registered=False).send()
    bench = StationBench()
    bench.until(40_100)
    with pytest.raises(FogUnreachable):
        bench.send()
    bench = StationBench()
    bench.hear("reachable", FogPresence(session=99, up=True))
    with pytest.raises(FogUnreachable):
        bench.send()


@pytest.mark.parametrize("how", [{"ttl_ms": 0}, {"ttl_ms": 60_001}, {"command": Goto(1.0, 2.0, 3.0), "drone": None}])
def test_what_cannot_be_sent_is_a_users_mistake(how: dict[str, Any]) -> None:
    with pytest.raises(ConfigurationError):
        StationBench().send(**how)


def test_numbers_rise_by_one_over_all_topics_and_deadlines_are_of_the_fogs_clock(bench: StationBench) -> None:
    one, two = bench.send(), bench.send(Hold(), None)
    assert (one.topic, two.topic) == ("fog1/drone1/commands", "fog1/commands")
    first, second = decode(CommandMessage, one.payload), decode(CommandMessage, two.payload)
    assert (first.seq, second.seq, first.executor_session) == (1, 2, FOG)
    assert first.deadline_ms is not None
    assert 0 <= bench.now_ms + 5000 - first.deadline_ms <= 15
    assert (one.retain, one.expiry_s) == (False, 5)


def test_there_is_exactly_one_last_word(bench: StationBench) -> None:
    bench.send()
    assert bench.result(Word.ACCEPTED) == [(Word.ACCEPTED, False)]
    assert bench.result(Word.ACCEPTED) == []
    assert bench.result(Word.COMPLETED) == [(Word.COMPLETED, False)]
    assert bench.result(Word.FAILED) == []


def test_progress_never_goes_back(bench: StationBench) -> None:
    """R5.18."""
    bench.send()
    said = [(percent, bench.result(Word.IN_PROGRESS, percent=percent)) for percent in (10, 60, 40, 60, 61, None, 5)]
    assert [percent for percent, outcomes in said if outcomes] == [10, 60, 61, None]
    assert bench.result(Word.COMPLETED) == [(Word.COMPLETED, False)]


def test_a_progress_that_comes_late_says_nothing_behind_accepted(bench: StationBench) -> None:
    """R5.18. A drone says `accepted` behind `in_progress`, never before it."""
    bench.send()
    said = [bench.result(Word.IN_PROGRESS, percent=10), bench.result(Word.ACCEPTED)]
    assert said == [[(Word.IN_PROGRESS, False)], [(Word.ACCEPTED, False)]]
    assert [bench.result(Word.IN_PROGRESS, percent=percent) for percent in (5, 10, 60, None)] == [[]] * 4
    assert bench.result(Word.ACCEPTED) == []
    assert bench.result(Word.COMPLETED) == [(Word.COMPLETED, False)]


def test_the_truth_after_an_unconfirmed_settles_it_once(bench: StationBench) -> None:
    bench.send()
    assert bench.result(Word.UNCONFIRMED) == [(Word.UNCONFIRMED, False)]
    assert bench.result(Word.COMPLETED, settled=True) == [(Word.COMPLETED, True)]
    assert bench.result(Word.FAILED, settled=True) == []


@pytest.mark.parametrize("first", [Word.ACCEPTED, Word.IN_PROGRESS])
@pytest.mark.parametrize("word", [word for word in Word if word.is_definite_no])
def test_a_definite_no_behind_a_first_word_settles_nothing(bench: StationBench, first: Word, word: Word) -> None:
    """R5.9: another implementation's activator may pass one on."""
    bench.send()
    bench.result(first)
    bench.result(Word.UNCONFIRMED)
    assert bench.result(word, settled=True) == []
    assert bench.result(Word.COMPLETED, settled=True) == [(Word.COMPLETED, True)]


@pytest.mark.parametrize("drone", [1, 2, None])
@pytest.mark.parametrize("mode", [SelectMode.SELECT, SelectMode.OFFER, SelectMode.COMMIT])
def test_at_qos_0_a_choice_is_not_repeated_behind_a_hold_until_it_is_a_question(
    mode: SelectMode, drone: int | None
) -> None:
    bench = StationBench(qos=0)
    chosen = select(bench, mode=mode, ttl_ms=5000)
    bench.send(Hold(), drone=drone)
    assert of(bench.until(14_900), "fog1/commands/goto") == []
    assert of(bench.until(15_000), "fog1/commands/goto") == [chosen]


@pytest.mark.parametrize(("held", "is_repeated"), [(1, False), (None, False), (2, True)])
def test_at_qos_0_a_command_is_not_repeated_behind_a_hold_of_its_drone(held: int | None, is_repeated: bool) -> None:
    bench = StationBench(qos=0)
    sent = bench.send(Takeoff(10.0), ttl_ms=5000)
    bench.send(Hold(), drone=held)
    assert (sent in bench.until(14_900)) == is_repeated
    assert sent in bench.until(30_000)


def test_at_qos_0_what_stops_a_drone_is_repeated_behind_a_hold() -> None:
    bench = StationBench(qos=0)
    sent = bench.send(Land(), ttl_ms=5000)
    bench.send(Hold())
    assert sent in bench.until(12_000)


def test_after_a_reconnection_only_what_was_heard_is_asked_for_behind_a_hold(bench: StationBench) -> None:
    """What was lost with the connection would be started behind the hold that was to stop it."""
    heard = bench.send(Takeoff(10.0))
    bench.result(Word.ACCEPTED)
    lost, chosen = bench.send(Goto(47.4, 8.5, 20.0)), select(bench)
    held = bench.send(Hold())
    again = reconnect(bench)
    assert [one in again for one in (heard, lost, chosen, held)] == [True, False, False, True]


def test_a_hold_that_could_not_be_sent_keeps_what_it_was_to_stop_from_being_repeated(bench: StationBench) -> None:
    """Whoever says hold while the connection is lost would otherwise see the drone leave as soon as it is back."""
    going, chosen = bench.send(Goto(47.4, 8.5, 20.0), ttl_ms=60_000), select(bench, ttl_ms=60_000)
    bench.role.on_disconnected("cloud", bench.now_ms)
    with pytest.raises(FogUnreachable):
        bench.send(Hold())
    again = reconnect(bench)
    assert [one in again for one in (going, chosen)] == [False, False]
    wanted, chosen = bench.send(Goto(47.4, 8.5, 30.0), ttl_ms=60_000), select(bench, ttl_ms=60_000)
    again = reconnect(bench)
    assert [one in again for one in (wanted, chosen)] == [True, True]


def test_a_choice_behind_a_hold_that_could_not_be_sent_is_repeated() -> None:
    bench = StationBench(qos=0)
    bench.role.on_disconnected("cloud", bench.now_ms)
    with pytest.raises(FogUnreachable):
        bench.send(Hold())
    reconnect(bench)
    chosen = select(bench)
    assert chosen in bench.until(bench.now_ms + 3000)


def test_failing_everybody_else_the_station_closes_it_as_unconfirmed(bench: StationBench) -> None:
    bench.send(limit_s=1.0)
    told = [o.word for o in bench.until(60_000) if isinstance(o, Outcome)]
    assert told == [Word.UNCONFIRMED]
    assert bench.result(Word.COMPLETED) == [(Word.COMPLETED, True)]


def test_a_foreign_result_is_no_outcome(bench: StationBench) -> None:
    bench.send()
    assert bench.result(Word.COMPLETED, seq=9) == []


def reconnect(bench: StationBench) -> list[Any]:
    """What a station says once it is registered again behind a lost connection."""
    bench.role.on_disconnected("cloud", bench.now_ms)
    for effect in bench.role.on_connected("cloud", bench.now_ms):
        bench.role.on_subscribed(effect, bench.now_ms)  # type: ignore[arg-type]
    return bench.confirm(bench.hear("reachable", FogPresence(session=FOG, up=True)))


def test_after_a_reconnection_open_commands_are_asked_for_by_the_same_bytes(bench: StationBench) -> None:
    sent = bench.send()
    assert sent in reconnect(bench)
    bench.result(Word.COMPLETED)
    assert sent not in bench.until(bench.now_ms + 20_000)


def test_a_broadcast_has_a_last_word_for_each_drone_of_its_roster(bench: StationBench) -> None:
    bench.send(Hold(), None, limit_s=1.0)
    roster = (RosterEntry(drone=1, session=5), RosterEntry(drone=2))
    bench.hear("commands_result/hold", FogResultMessage(**OF_FOG, roster=roster))
    assert bench.result(Word.COMPLETED) == [(Word.COMPLETED, False)]
    told = [(o.drone, o.word) for o in bench.until(60_000) if isinstance(o, Outcome)]
    assert told == [(2, Word.UNCONFIRMED)]


@pytest.mark.parametrize(("bundles", "first_ms"), [(False, 2000), (True, 3000)])
def test_a_broadcast_at_qos_0_is_not_asked_for_while_its_words_may_wait(bundles: bool, first_ms: int) -> None:
    """The roster waits for a second at the activator, a first word for another one at its drone (R10.6, R10.7)."""
    bench = StationBench(qos=0, bundles=bundles)
    sent = bench.send(Arm(), drone=None)
    began_ms = bench.now_ms
    assert of(bench.until(began_ms + first_ms - 100), sent.topic) == []
    bench.hear("commands_result/arm", FogResultMessage(**OF_FOG, roster=(RosterEntry(drone=1, session=5),)))
    heard_ms = bench.now_ms
    assert of(bench.until(heard_ms + 2900), sent.topic) == []
    assert [publish.payload for publish in of(bench.until(heard_ms + 3000), sent.topic)] == [sent.payload]


@pytest.mark.parametrize(
    ("command", "bundles", "first_ms"), [(Arm(), False, 2000), (Arm(), True, 3000), (Hold(), True, 2000)]
)
def test_a_broadcast_at_qos_0_that_is_lost_is_asked_for(command: Command, bundles: bool, first_ms: int) -> None:
    bench = StationBench(qos=0, bundles=bundles)
    sent, began_ms = bench.send(command, drone=None), bench.now_ms
    assert len(of(bench.until(began_ms + first_ms), sent.topic)) == 1


def test_a_fogs_denial_ends_a_broadcast(bench: StationBench) -> None:
    bench.send(Hold(), None)
    denial = FogResultMessage(**OF_FOG, denied="ledger_full")
    (outcome,) = bench.hear("commands_result/hold", denial)
    assert (outcome.drone, outcome.word, outcome.reason) == (None, Word.DENIED, "ledger_full")
    assert bench.hear("commands_result/hold", denial) == []


def test_a_fogs_denial_behind_a_drones_first_word_is_no_definite_no() -> None:
    """As of an activator that was started anew and knows of no drone: what was begun may go on."""
    denial = FogResultMessage(gs_session=GS_SESSION, seq=1, session=0x23, stamp=1, denied="expired")
    for select in (True, False):
        bench, name = StationBench(), "goto" if select else "arm"
        if select:
            bench.role.commands.select(bench.role.fog(1), Goto(47.0, 8.0, 10.0), bench.now_ms, limit_s=1.0)
        else:
            bench.send(Arm(), None, limit_s=1.0)
        assert bench.result(Word.ACCEPTED) == [(Word.ACCEPTED, False)]
        told = [o for o in bench.hear(f"commands_result/{name}", denial) if isinstance(o, Outcome)]
        assert [(o.drone, o.word, o.reason) for o in told] == [(1, Word.UNCONFIRMED, "denied after accepted")]
        assert bench.result(Word.COMPLETED) == [(Word.COMPLETED, True)]
        late = [o for o in bench.until(60_000) if isinstance(o, Outcome)]
        assert [(o.drone, o.word) for o in late] == ([] if select else [(None, Word.UNCONFIRMED)])


def test_a_broadcast_whose_roster_was_lost_has_a_last_word_for_each_drone_that_was_heard(bench: StationBench) -> None:
    bench.send(Arm(), None, limit_s=1.0)
    bench.result(Word.ACCEPTED)
    told = [(o.drone, o.word) for o in bench.until(60_000) if isinstance(o, Outcome)]
    assert told == [(1, Word.UNCONFIRMED), (None, Word.UNCONFIRMED)]


def select(bench: StationBench, **how: Any) -> Publish:
    _, (publish,) = bench.role.commands.select(bench.role.fog(1), Goto(1.0, 2.0, 3.0), bench.now_ms, **how)
    assert isinstance(publish, Publish)
    return publish


def told_of(outputs: list[Any]) -> list[tuple[int | None, Word, str | None]]:
    return [(o.drone, o.word, o.reason) for o in outputs if isinstance(o, Outcome)]


def of_goto(bench: StationBench, drone: int, word: Word) -> list[Any]:
    message = ResultMessage(gs_session=GS_SESSION, seq=1, session=5, stamp=1, word=word)
    return bench.hear(f"drone{drone}/commands_result/goto", message)


def psmi(bench: StationBench, **fields: Any) -> list[Any]:
    return bench.hear("PSMI", PsmiMessage(**OF_FOG, left_out=(), **fields))


def test_a_choice_that_every_drone_denies_and_no_activator_ends_is_unconfirmed(bench: StationBench) -> None:
    """R7.8: an activator of a later session asked all drones, and does not know whether these are all."""
    select(bench, limit_s=1.0)
    for drone in (1, 2):
        of_goto(bench, drone, Word.EXPIRED)
    assert told_of(bench.until(60_000)) == [(None, Word.UNCONFIRMED, None)]
    assert not any(pending.is_open for pending in bench.role.commands.pending.values())


def test_a_choice_is_over_with_the_word_of_the_drone_that_was_sent_also_where_an_earlier_denial_was_lost(
    bench: StationBench,
) -> None:
    """R7.6: PSMI tries the next drone after a definite no alone, so drone 1 has said one."""
    select(bench)
    for drone in (1, 2):
        psmi(bench, listed=(), chosen=drone)
    of_goto(bench, 2, Word.ACCEPTED)
    assert told_of(of_goto(bench, 2, Word.COMPLETED)) == [(2, Word.COMPLETED, None)]
    assert not bench.role.commands.pending[CommandId(GS_SESSION, 1)].is_open


def test_a_choice_whose_drone_is_silent_waits_for_it_whatever_others_say(bench: StationBench) -> None:
    """R7.8: a restarted activator asks every drone; one that it does not reach says nothing of the one that flies."""
    select(bench)
    for drone in (1, 2):
        psmi(bench, listed=(), chosen=drone)
    of_goto(bench, 1, Word.UNCONFIRMED)
    assert bench.role.commands.pending[CommandId(GS_SESSION, 1)].is_open
    of_goto(bench, 2, Word.COMPLETED)
    assert not bench.role.commands.pending[CommandId(GS_SESSION, 1)].is_open


def test_another_drones_word_does_not_end_a_commit(bench: StationBench) -> None:
    """R7.8: the commit's list was lost, and a restarted activator asks every drone; drone 4 may be flying it."""
    select(bench, mode=SelectMode.COMMIT, reservation=9, drone=4)
    assert told_of(of_goto(bench, 3, Word.EXPIRED)) == []
    assert told_of(of_goto(bench, 4, Word.ACCEPTED)) == [(4, Word.ACCEPTED, None)]
    assert told_of(of_goto(bench, 4, Word.COMPLETED)) == [(4, Word.COMPLETED, None)]


def test_at_qos_0_a_choice_whose_denial_was_lost_behind_its_empty_list_is_asked_for() -> None:
    bench = StationBench(qos=0)
    asked = select(bench)
    psmi(bench, listed=())
    assert of(bench.until(13_000), "fog1/commands/goto") == [asked]


def test_a_list_says_nothing_of_a_command_that_nobody_chooses_for(bench: StationBench) -> None:
    bench.send()
    assert psmi(bench, listed=(), chosen=7) == psmi(bench, listed=(), hold_until_ms=1) == []
    assert bench.result(Word.COMPLETED) == [(Word.COMPLETED, False)]
    assert not bench.role.commands.pending[CommandId(GS_SESSION, 1)].is_open


def test_control_that_goes_to_a_later_session_of_the_same_name_is_told(bench: StationBench) -> None:
    """A station with an identity has its name again behind a restart; its earlier session's lease lasts for 30 s."""
    told: list[Any] = []
    for session in (99, GS_SESSION, GS_SESSION):
        record = DroneRecord(activator_session=FOG, up=True, drone_session=5, holder="alpha", holder_session=session)
        told += bench.hear("drone1/reachable", record)
    assert [(one.holder, one.mine) for one in told if isinstance(one, ControlChanged)] == [
        ("alpha", False),
        ("alpha", True),
    ]


def test_a_station_that_wants_some_drones_asks_for_these_alone() -> None:
    bench = StationBench(registered=False, control=(3, 2))
    for subscribe in bench.subscribes:
        bench.role.on_subscribed(subscribe, bench.now_ms)
    (publish,) = of(bench.hear("reachable", FogPresence(session=FOG, up=True)), "fog1/init_connect")
    registration = decode(Registration, publish.payload)
    assert (registration.control, registration.drones) == (Control.WANT, (2, 3))
    with pytest.raises(ConfigurationError, match="drone 251"):
        StationBench(control=[251])
    with pytest.raises(ConfigurationError, match="control 1: expected True, False or drones' numbers, as"):
        StationBench(control=1)


def test_a_takeover_of_all_drones_is_of_all_also_where_some_are_claimed() -> None:
    bench = StationBench(control=False)
    bench.role.claim(1, 2, True, bench.now_ms)
    (publish,) = bench.role.take_over(1, None, bench.now_ms)
    assert isinstance(publish, Publish)
    assert decode(Registration, publish.payload).drones is None


@pytest.mark.parametrize(
    "record",
    [
        DroneRecord(activator_session=FOG, up=False),
        DroneRecord(activator_session=99, up=True, drone_session=5),
    ],
)
def test_reachable_needs_a_record_of_the_live_activators_session(record: DroneRecord) -> None:
    assert StationBench().hear("drone1/reachable", record) == [Reachability(1, 1, False)]


def test_reachable_needs_beacons() -> None:
    assert Reachability(1, 1, False) in StationBench().until(40_100)


def test_a_late_will_is_answered_with_a_new_birth_also_below_a_prefix() -> None:
    station = StationRole("alpha", GS_SESSION, Settings(), prefix="acme")
    station.on_connected("cloud", 0)
    station.on_message("cloud", Inbound("acme/gs/alpha/reachable", encode(Presence(session=9, up=False)), 1), 100)
    assert len(of(station.tick(1100), "acme/gs/alpha/reachable")) == 1


def test_a_forged_will_again_and_again_does_not_put_the_birth_off() -> None:
    station, births = StationRole("alpha", GS_SESSION, Settings()), 0
    station.on_connected("cloud", 0)
    forged = Inbound("gs/alpha/reachable", encode(Presence(session=GS_SESSION, up=False)), 1)
    for now_ms in range(2000, 12_000, 100):
        if now_ms % 800 == 0:
            station.on_message("cloud", forged, now_ms)
        births += len(of(station.tick(now_ms), "gs/alpha/reachable"))
    assert 5 <= births <= 10


def test_a_clean_stop_ends_the_lease() -> None:
    end, down = StationBench().role.goodbye(10_000)
    assert decode(Registration, end.payload).lease_s == 0  # type: ignore[union-attr]
    assert not decode(Presence, down.payload).up  # type: ignore[union-attr]


# All roles together


def outcomes(world: World) -> list[Word]:
    return [event.word for event in world.heard if isinstance(event, Outcome)]


@pytest.mark.parametrize("qos", [0, 1])
def test_a_command_flies_from_end_to_end(qos: int) -> None:
    world = World(qos, now_ms=1000).start(500)
    world.send(Arm())
    world.autopilot(ack(ARM), heartbeat(armed=True))
    assert outcomes(world) == [Word.ACCEPTED, Word.COMPLETED]
    assert len(world.wrote) == 1
    assert world.logs == []
    updates = [event for event in world.heard if isinstance(event, StateUpdate)]
    assert updates
    assert all(update.age_ms is not None for update in updates)


def test_lost_results_at_qos_0_are_asked_for_and_nothing_runs_twice() -> None:
    world = World(0, now_ms=1000).start(500)
    world.drop = {"commands_result"}
    world.send(Arm())
    world.autopilot(ack(ARM), heartbeat(armed=True))
    assert outcomes(world) == []
    world.drop = set()
    world.pass_time(4000)
    assert outcomes(world)[-1] is Word.COMPLETED
    assert len(world.wrote) == 1


def test_a_restarted_drone_closes_what_it_left_open() -> None:
    world = World(now_ms=1000).start(500)
    command_id = world.send(Arm())
    world.restart_uav(0x44, [Unfinished(command_id, "arm")])
    world.pass_time(3000)
    assert outcomes(world) == [Word.UNCONFIRMED]
    assert len(world.wrote) == 1


def test_a_restarted_activator_asks_the_drone_and_executes_nothing_again() -> None:
    world = World(now_ms=1000).start(500)
    world.send(Arm())
    world.restart_activator(0x55)
    world.autopilot(ack(ARM), heartbeat(armed=True))
    world.pass_time(5000)
    assert outcomes(world)[-1] is Word.COMPLETED
    assert len(world.wrote) == 1
