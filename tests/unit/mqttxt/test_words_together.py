"""Words of a broadcast that leave the activator in one message (docs/protocol.md, R10.6 and R12.11)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cbor2
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mqttxt.activator.process import ActivatorRunner
from mqttxt.activator.together import LONGEST, PATIENT, WordsTogether
from mqttxt.core.address import BrokerAddress
from mqttxt.core.channel import Channel
from mqttxt.core.effects import Log, Publish
from mqttxt.core.settings import TOGETHER_MS, Settings
from mqttxt.errors import PayloadError
from mqttxt.protocol.cbor import MAX_PAYLOAD
from mqttxt.protocol.codec import decode, encode
from mqttxt.protocol.commands import Arm, Goto, Hold, Land
from mqttxt.protocol.messages import (
    MOST_TOGETHER,
    By,
    CommandId,
    FogResultMessage,
    Presence,
    ResultMessage,
    RosterEntry,
    Word,
    WordTogether,
)
from mqttxt.protocol.rankings import SelectMessage, SelectMode
from mqttxt.protocol.states import Battery
from mqttxt.protocol.topics import CloudSide
from mqttxt.protocol.values import Encoding
from mqttxt.security.cose import Envelope
from mqttxt.security.together import encode_together, parse_together
from mqttxt.station.outcomes import Outcome
from tests.examples import examples
from tests.rigs.processes import eventually
from tests.simulation.fogs import UAV_AHEAD_MS, ActivatorBench
from tests.simulation.signed import word as signed_word
from tests.simulation.signing import seal
from tests.simulation.world import FOG_SESSION, GS_SESSION, UAV_SESSION, World, ack, heartbeat

OF_FOG = "fog1/commands_result/"
ARM = "drone1/commands_result/arm"


@pytest.fixture
def plain_world() -> World:
    return World().start(1000)


@pytest.fixture
def bench() -> ActivatorBench:
    return three()


def three(bundles: bool = True) -> ActivatorBench:
    """Drones 1 to 3 are reachable and under the control of a station, which asked for bundles or did not."""
    bench = ActivatorBench(drones=(1, 2, 3))
    for drone in (1, 2, 3):
        bench.appear(drone, UAV_SESSION + drone)
    bench.register(bundles=bundles)
    return bench


def say(bench: ActivatorBench, drone: int, word: Word, name: str = "arm", **more: Any) -> list[Any]:
    """What a drone says of the broadcast 1."""
    stamp = (bench.now_ms + UAV_AHEAD_MS) // 10 % 65536
    fields = {"gs_session": GS_SESSION, "seq": 1, "session": UAV_SESSION + drone, "stamp": stamp, "word": word}
    return bench.fog(f"drone{drone}/commands_result/{name}", ResultMessage(**{**fields, **more}))  # type: ignore[arg-type]


def later(bench: ActivatorBench, milliseconds: int) -> list[Any]:
    bench.now_ms += milliseconds
    return list(bench.role.say_together(bench.now_ms))


def told(effects: list[Any]) -> list[list[tuple[int, Word]]]:
    """The words of each message in its order: (drone, word)."""
    out: list[list[tuple[int, Word]]] = []
    for publish in (effect for effect in effects if isinstance(effect, Publish) and "commands_result" in effect.topic):
        if publish.topic.startswith(OF_FOG):
            out.append([(word.drone, word.word) for word in decode(FogResultMessage, publish.payload).words or ()])
        elif publish.link == "cloud":
            drone = int(publish.topic.split("/")[1].removeprefix("drone"))
            out.append([(drone, decode(ResultMessage, publish.payload).word)])
    return out


def broadcast(bench: ActivatorBench, **more: Any) -> None:
    """A broadcast whose roster has left by itself."""
    bench.command(to="commands", **more)
    (roster,) = later(bench, TOGETHER_MS)
    assert decode(FogResultMessage, roster.payload).roster


def test_what_comes_within_the_window_leaves_together_at_its_end(bench: ActivatorBench) -> None:
    broadcast(bench)
    assert say(bench, 2, Word.ACCEPTED) == []
    assert bench.role.together_due_ms == bench.now_ms + TOGETHER_MS
    assert later(bench, 20) == say(bench, 1, Word.COMPLETED) == []
    assert later(bench, TOGETHER_MS - 21) == []
    (publish,) = later(bench, 1)
    assert (publish.topic, publish.qos, publish.retain) == ("fog1/commands_result/arm", 1, False)
    assert told([publish]) == [[(2, Word.ACCEPTED), (1, Word.COMPLETED)]]
    assert bench.role.together_due_ms is None
    message = decode(FogResultMessage, publish.payload)
    assert (message.id, message.session, message.roster) == (CommandId(GS_SESSION, 1), FOG_SESSION, None)


@pytest.mark.parametrize("words", [(Word.ACCEPTED,), (Word.ACCEPTED, Word.COMPLETED), (Word.COMPLETED,)])
def test_they_leave_at_once_when_no_drone_is_left_to_wait_for(bench: ActivatorBench, words: tuple[Word, ...]) -> None:
    broadcast(bench)
    for word in words:
        assert say(bench, 1, word) == say(bench, 3, word) == []
        assert told(say(bench, 2, word)) == [[(1, word), (3, word), (2, word)]]
        assert bench.role.together_due_ms is None


def test_nobody_waits_for_a_drone_that_has_its_last_word(bench: ActivatorBench) -> None:
    broadcast(bench)
    assert told(say(bench, 1, Word.FAILED, reason="x")) == [[(1, Word.FAILED)]]
    assert say(bench, 2, Word.ACCEPTED) == []
    assert told(say(bench, 3, Word.COMPLETED)) == [[(2, Word.ACCEPTED), (3, Word.COMPLETED)]]


def test_the_next_word_of_a_drone_leaves_in_the_place_of_a_first_word(bench: ActivatorBench) -> None:
    broadcast(bench)
    for drone, word in ((1, Word.ACCEPTED), (2, Word.ACCEPTED), (1, Word.IN_PROGRESS), (1, Word.COMPLETED)):
        assert say(bench, drone, word) == []
    assert told(later(bench, TOGETHER_MS)) == [[(2, Word.ACCEPTED), (1, Word.COMPLETED)]]


def test_a_first_word_that_tells_of_a_late_write_keeps_its_place(bench: ActivatorBench) -> None:
    broadcast(bench)
    say(bench, 1, Word.ACCEPTED, late_ms=3)
    say(bench, 1, Word.COMPLETED)
    assert told(later(bench, TOGETHER_MS)) == [[(1, Word.ACCEPTED), (1, Word.COMPLETED)]]


def test_a_definite_no_behind_a_first_word_that_it_replaces_is_none(bench: ActivatorBench) -> None:
    broadcast(bench)
    say(bench, 1, Word.ACCEPTED)
    (publish,) = [effect for effect in say(bench, 1, Word.DENIED, reason="x") if isinstance(effect, Publish)]
    said = decode(ResultMessage, publish.payload)
    assert (said.word, said.reason) == (Word.UNCONFIRMED, "denied after accepted")


def test_the_roster_leaves_in_front_of_the_first_words(bench: ActivatorBench) -> None:
    commands = [effect.topic for effect in bench.command(to="commands") if isinstance(effect, Publish)]
    assert commands == [f"drone{n}/commands" for n in (1, 2, 3)]
    assert bench.role.together_due_ms == bench.now_ms + TOGETHER_MS
    say(bench, 1, Word.ACCEPTED)
    say(bench, 2, Word.ACCEPTED)
    (publish,) = [effect for effect in say(bench, 3, Word.ACCEPTED) if isinstance(effect, Publish)]
    message = decode(FogResultMessage, publish.payload)
    assert [entry.drone for entry in message.roster or ()] == [1, 2, 3]
    assert [word.drone for word in message.words or ()] == [1, 2, 3]


def test_a_roster_leaves_with_a_no_at_once(bench: ActivatorBench) -> None:
    bench.fog("drone2/reachable", Presence(session=UAV_SESSION + 2, up=False))
    out = bench.command(to="commands")
    (publish,) = [effect for effect in out if isinstance(effect, Publish) and effect.topic == f"{OF_FOG}arm"]
    message = decode(FogResultMessage, publish.payload)
    assert [entry.drone for entry in message.roster or ()] == [1, 2, 3]
    assert [(word.drone, word.word) for word in message.words or ()] == [(2, Word.UNREACHABLE)]


def test_a_roster_of_nobody_and_one_of_many_drones_leave_at_once() -> None:
    for drones in ((), tuple(range(1, MOST_TOGETHER + 2))):
        bench = ActivatorBench(drones=drones)
        bench.register(bundles=True)
        out = [effect for effect in bench.command(to="commands") if isinstance(effect, Publish)]
        message = decode(FogResultMessage, out[0].payload)
        assert [entry.drone for entry in message.roster or ()] == list(drones)
        assert message.words is None


def test_each_word_keeps_its_session_and_stamps_from_before_the_wait() -> None:
    apart, together = three(bundles=False), three()
    alone = []
    for bench in (apart, together):
        bench.command(to="commands")
        later(bench, TOGETHER_MS)
        for drone in (1, 3):
            alone += say(bench, drone, Word.COMPLETED, observed=False)
            later(bench, 10)
    (publish,) = later(together, TOGETHER_MS)
    words = decode(FogResultMessage, publish.payload)
    assert [word.result(words) for word in words.words or ()] == [
        decode(ResultMessage, one.payload) for one in alone if isinstance(one, Publish)
    ]


def test_one_word_leaves_as_it_ever_did(bench: ActivatorBench) -> None:
    broadcast(bench)
    say(bench, 2, Word.ACCEPTED)
    (publish,) = later(bench, TOGETHER_MS)
    assert publish.topic == "fog1/drone2/commands_result/arm"
    assert decode(ResultMessage, publish.payload).word is Word.ACCEPTED


@pytest.mark.parametrize("word", [word for word in Word if word not in PATIENT])
def test_any_other_word_leaves_at_once_with_those_in_front_of_it(bench: ActivatorBench, word: Word) -> None:
    broadcast(bench)
    say(bench, 1, Word.ACCEPTED)
    assert told(say(bench, 2, word, reason="x")) == [[(1, Word.ACCEPTED), (2, word)]]
    assert told(say(bench, 3, word, reason="x")) == [[(3, word)]]
    assert later(bench, TOGETHER_MS) == []


@pytest.mark.parametrize("changed", [{}, {"to": "commands", "executor_session": FOG_SESSION + 1}])
def test_words_about_one_drones_command_and_of_a_query_do_not_wait(changed: dict[str, Any]) -> None:
    bench = three()
    said = told(bench.command(**changed))
    assert said == ([[]] if changed else [])  # the roster of a query does not wait either
    assert told(say(bench, 1, Word.ACCEPTED)) == [[(1, Word.ACCEPTED)]]


def test_a_station_that_did_not_ask_for_bundles_hears_roster_and_words_alone() -> None:
    bench = three(bundles=False)
    bench.register(name="other", session=GS_SESSION + 1, bundles=True)
    assert told(bench.command(to="commands")) == [[]]
    assert told(say(bench, 1, Word.ACCEPTED)) == [[(1, Word.ACCEPTED)]]


def test_what_is_said_of_another_command_leaves_behind_what_waits(bench: ActivatorBench) -> None:
    broadcast(bench)
    bench.command(Land(), to="drone1/commands", seq=2)
    say(bench, 1, Word.ACCEPTED)
    say(bench, 2, Word.ACCEPTED)
    out = say(bench, 1, Word.ACCEPTED, "land", seq=2)
    assert told(out) == [[(1, Word.ACCEPTED), (2, Word.ACCEPTED)], [(1, Word.ACCEPTED)]]
    say(bench, 3, Word.ACCEPTED)
    denial = bench.command(Hold(), to="drone3/commands", seq=1)
    assert told(denial) == [[(3, Word.ACCEPTED)], [(3, Word.DENIED)]]


def test_two_broadcasts_do_not_share_a_message(bench: ActivatorBench) -> None:
    broadcast(bench)
    say(bench, 1, Word.ACCEPTED)
    assert told(bench.command(Hold(), to="commands", seq=2)) == [[(1, Word.ACCEPTED)]]
    assert say(bench, 1, Word.ACCEPTED, "hold", seq=2) == []
    out = say(bench, 1, Word.SUPERSEDED, by=By(gs_session=1, seq=2))
    assert told(out) == [[(1, Word.ACCEPTED)], [(1, Word.SUPERSEDED)]]


def test_a_duplicate_is_answered_behind_what_waits(bench: ActivatorBench) -> None:
    deadline_ms = bench.now_ms + 5000
    broadcast(bench, deadline_ms=deadline_ms)
    for drone, word in ((1, Word.ACCEPTED), (1, Word.COMPLETED), (2, Word.ACCEPTED)):
        say(bench, drone, word)
    first, roster, *said = told(bench.command(to="commands", deadline_ms=deadline_ms))
    assert first == [(1, Word.COMPLETED), (2, Word.ACCEPTED)]
    assert (roster, said) == ([], [[(1, Word.COMPLETED)], [(2, Word.ACCEPTED)]])
    assert later(bench, TOGETHER_MS) == []


def test_the_truth_behind_an_unconfirmed_leaves_behind_what_waits(bench: ActivatorBench) -> None:
    bench.command(to="commands", limit_s=0.1)
    said = told(bench.until(bench.now_ms + 12_000))
    assert sorted(said) == [[], *([(n, Word.UNCONFIRMED)] for n in (1, 2, 3))]
    assert told(say(bench, 1, Word.COMPLETED)) == [[(1, Word.COMPLETED)]]


def test_at_a_clean_stop_what_waits_leaves_before_down_and_nothing_waits_any_more(bench: ActivatorBench) -> None:
    bench.command(to="commands")
    say(bench, 1, Word.ACCEPTED)
    say(bench, 2, Word.ACCEPTED)
    first, *rest = bench.role.goodbye(bench.now_ms)
    assert told([first]) == [[(1, Word.ACCEPTED), (2, Word.ACCEPTED)]]
    assert any(isinstance(effect, Publish) and effect.topic == "fog1/reachable" for effect in rest)
    assert told(say(bench, 3, Word.ACCEPTED)) == [[(3, Word.ACCEPTED)]]
    assert told(bench.command(Hold(), to="commands", seq=2))[0] == []


def test_a_drone_that_starts_anew_and_a_fog_that_is_lost_take_nothing_from_what_waits(bench: ActivatorBench) -> None:
    broadcast(bench)
    say(bench, 1, Word.ACCEPTED)
    say(bench, 2, Word.ACCEPTED)
    bench.appear(1, UAV_SESSION + 50)
    bench.fog("drone2/reachable", Presence(session=UAV_SESSION + 2, up=False))
    bench.role.on_disconnected("fog", bench.now_ms)
    bench.register(lease_s=0)
    assert told(later(bench, TOGETHER_MS)) == [[(1, Word.ACCEPTED), (2, Word.ACCEPTED)]]


def test_after_hours_of_sleep_what_waits_leaves_in_front_of_what_nobody_heard_of(bench: ActivatorBench) -> None:
    broadcast(bench)
    say(bench, 1, Word.COMPLETED)
    say(bench, 2, Word.ACCEPTED)
    bench.now_ms += 3 * 3_600_000
    first, *rest = told(bench.role.tick(bench.now_ms))
    assert first == [(1, Word.COMPLETED), (2, Word.ACCEPTED)]
    assert rest == [[(2, Word.UNCONFIRMED)], [(3, Word.UNCONFIRMED)]]
    assert told(bench.until(bench.now_ms + 3000)) == []


def test_the_tick_says_what_is_due_too(bench: ActivatorBench) -> None:
    broadcast(bench)
    say(bench, 1, Word.ACCEPTED)
    say(bench, 2, Word.ACCEPTED)
    assert told(bench.until(bench.now_ms + TOGETHER_MS + 100)) == [[(1, Word.ACCEPTED), (2, Word.ACCEPTED)]]


def test_states_that_wait_leave_beside_words(bench: ActivatorBench) -> None:
    broadcast(bench)
    bench.until(bench.now_ms + 1500)
    assert [effect for effect in bench.tell(Battery(50)) if isinstance(effect, Publish)] == []
    out = say(bench, 1, Word.FAILED, reason="x")
    assert [effect.topic for effect in out if isinstance(effect, Publish)] == [
        "fog1/drone1/commands_result/arm",
        "fog1/states",
    ]


SEQS = st.sampled_from([1, 1, 1, 2, 3])
ACTIONS = st.one_of(
    st.tuples(st.just("say"), st.integers(1, 3), st.sampled_from(sorted(PATIENT) * 3 + [*Word]), SEQS),
    st.tuples(st.just("broadcast"), st.sampled_from([Arm(), Hold()]), SEQS),
    st.tuples(st.just("command"), st.integers(1, 3), SEQS),
    st.tuples(st.just("later"), st.sampled_from([1, 20, TOGETHER_MS, 7000])),
    st.tuples(st.just("anew"), st.integers(1, 3)),
)


def does(bench: ActivatorBench, action: tuple[Any, ...], deadline_ms: int) -> list[Any]:
    match action:
        case ("say", drone, word, seq):
            percent = 40 if word is Word.IN_PROGRESS else None
            return say(bench, drone, word, seq=seq, percent=percent)
        case ("broadcast", command, seq):
            return bench.command(command, to="commands", seq=seq, deadline_ms=deadline_ms, limit_s=0.5)
        case ("command", drone, seq):
            return bench.command(to=f"drone{drone}/commands", seq=seq, deadline_ms=deadline_ms, limit_s=0.5)
        case ("later", milliseconds):
            bench.now_ms += milliseconds
            return [*bench.role.say_together(bench.now_ms), *bench.role.tick(bench.now_ms)]
        case ("anew", drone):
            return bench.fog(f"drone{drone}/reachable", Presence(session=UAV_SESSION + drone, up=False))
    raise AssertionError(action)


def taken_apart(effects: list[Any]) -> list[tuple[int, ResultMessage] | FogResultMessage]:
    """What was said, in its order, as if roster and words had come alone."""
    out: list[tuple[int, ResultMessage] | FogResultMessage] = []
    for publish in (effect for effect in effects if isinstance(effect, Publish) and effect.link == "cloud"):
        if publish.topic.startswith(OF_FOG):
            message = decode(FogResultMessage, publish.payload)
            if message.roster is not None or message.denied is not None:
                out.append(replace(message, words=None, stamp=0))
            out += [(word.drone, word.result(message)) for word in message.words or ()]
        elif "/commands_result/" in publish.topic:
            drone = int(publish.topic.split("/")[1].removeprefix("drone"))
            out.append((drone, decode(ResultMessage, publish.payload)))
    return out


def missing(said: list[Any], left: list[Any]) -> list[int]:
    """The places of what was said and has not left; the rest has left in its order."""
    places, at = [], 0
    for place, one in enumerate(said):
        if at < len(left) and left[at] == one:
            at += 1
        else:
            places.append(place)
    assert at == len(left), f"{left[at]} was not said, or not there"
    return places


@examples(300)
@given(actions=st.lists(ACTIONS, max_size=25))
def test_whatever_happens_all_words_leave_once_in_their_order_and_in_time(actions: list[tuple[Any, ...]]) -> None:
    apart, together = three(bundles=False), three()
    said: list[Any] = []
    left: list[Any] = []
    for action in [("broadcast", Arm(), 1), *actions]:
        deadline_ms = apart.now_ms // 4000 * 4000 + 5000
        said += does(apart, action, deadline_ms)
        left += does(together, action, deadline_ms)
        due_ms = together.role.together_due_ms
        assert due_ms is None or together.now_ms < due_ms <= together.now_ms + TOGETHER_MS
    left += together.role.goodbye(together.now_ms)
    whole = taken_apart(said)
    for place in missing(whole, taken_apart(left)):  # a first word in whose place the drone's next one left
        drone, word = whole[place]  # type: ignore[misc]
        assert not word.word.is_last
        assert word.late_ms is None
        assert any(
            of == drone and one.id == word.id for of, one in (e for e in whole[place + 1 :] if isinstance(e, tuple))
        )


def channel(encoding: Encoding = Encoding.CBOR) -> Channel:
    return Channel("cloud", "", Settings(encoding=encoding))


def gather(words: list[ResultMessage], encoding: Encoding = Encoding.CBOR) -> list[Publish]:
    """What leaves while words of drones 1, 2, … come at once."""
    together, to = WordsTogether(FOG_SESSION, channel(encoding), CloudSide(1)), channel(encoding)
    entries = tuple(RosterEntry(drone=drone, session=2**32 - 1) for drone in range(250 - len(words), 250))
    alone = Publish("cloud", "fog1/commands_result/arm", b"")
    out = together.open("arm", words[0].id, entries, alone, 0)
    for drone, word in enumerate(words, start=1):
        topic = f"fog1/drone{drone}/commands_result/arm"
        out += together.add("arm", drone, word, to.publish(topic, word), 0)
    assert together.due_ms is None
    return out


@pytest.mark.parametrize("encoding", Encoding)
def test_as_many_as_fit_leave_together_with_the_longest_that_they_can_say(encoding: Encoding) -> None:
    fields = {"gs_session": 2**32 - 1, "seq": 2**32 - 1, "session": 2**32 - 1, "stamp": 65535, "word": Word.COMPLETED}
    word = ResultMessage(**fields, reason="\N{HELICOPTER}" * 200, by=By(gs_session=2**32 - 1, seq=1))  # type: ignore[arg-type]
    (publish,) = gather([word] * MOST_TOGETHER, encoding)
    assert len(publish.payload) <= MAX_PAYLOAD
    assert len(decode(FogResultMessage, publish.payload).words or ()) == MOST_TOGETHER


def test_a_word_that_is_too_long_leaves_alone_behind_the_others() -> None:
    fields = {"gs_session": GS_SESSION, "seq": 1, "session": UAV_SESSION, "stamp": 1, "word": Word.ACCEPTED}
    word = ResultMessage(**fields)  # type: ignore[arg-type]
    together = WordsTogether(FOG_SESSION, channel(), CloudSide(1))
    first, long = (Publish("cloud", f"fog1/drone{n}/commands_result/arm", b"x" * n * LONGEST) for n in (1, 2))
    assert together.add("arm", 1, word, first, 0) == []
    assert together.add("arm", 2, word, long, 0) == [first, long]


# At the station.


@pytest.mark.parametrize("encoding", Encoding)
@pytest.mark.parametrize("signed", [False, True])
def test_a_station_hears_each_word_as_if_it_had_come_alone(encoding: Encoding, signed: bool) -> None:
    world = World(bundles=True, encoding=encoding, signed=signed).start(1000)
    sent = world.send(Arm(), None)
    assert (world.gs.commands.pending[sent].roster == (1,)) is signed  # a signed roster waits for nothing
    world.autopilot(ack(400))
    world.pass_time(1000)
    world.autopilot(heartbeat(armed=True))
    outcomes = [event for event in world.heard if isinstance(event, Outcome)]
    assert [(o.id, o.drone, o.word) for o in outcomes] == [(sent, 1, Word.ACCEPTED), (sent, 1, Word.COMPLETED)]
    assert [o.signer for o in outcomes] == ["drone1" if signed else None] * 2
    assert all(o.age_ms is not None for o in outcomes)
    pending = world.gs.commands.pending[sent]
    assert pending.roster == (1,)
    assert not pending.is_open


def test_what_is_around_signed_words_costs_little(world: World) -> None:
    words = [(1, Envelope.parse(signed_word("drone1", said, ARM))) for said in (Word.ACCEPTED, Word.COMPLETED)]
    apart = sum(len(envelope.encode()) for _, envelope in words)
    assert len(encode_together(words)) == apart + 2 + 1 + 2 * 2
    assert parse_together(encode_together(words)) == words
    assert parse_together(words[0][1].encode()) is None


def test_a_word_that_its_drone_has_not_signed_keeps_none_of_the_others_away(world: World) -> None:
    sent = world.send(Hold(), None)
    forged = signed_word("fog1", Word.COMPLETED, ARM.replace("arm", "hold"), seq=sent.seq)
    own = signed_word("drone1", Word.ACCEPTED, ARM.replace("arm", "hold"), seq=sent.seq)
    payload = encode_together([(1, Envelope.parse(forged)), (1, Envelope.parse(own))])
    out = world.hears("gs", "fog1/commands_result/hold", payload)
    assert [effect.kind for effect in out if isinstance(effect, Log)] == ["forged"]
    assert [(o.word, o.signer) for o in out if isinstance(o, Outcome)] == [(Word.ACCEPTED, "drone1")]


def test_an_activator_that_signs_words_in_its_drones_place_is_not_believed(world: World) -> None:
    sent = world.send(Hold(), None)
    words = (WordTogether(drone=1, session=UAV_SESSION, stamp=1, word=Word.COMPLETED),)
    message = FogResultMessage(gs_session=GS_SESSION, seq=sent.seq, session=FOG_SESSION, stamp=1, words=words)
    payload = seal("fog1").sign("fog1/commands_result/hold", encode(message)).encode()
    out = world.hears("gs", "fog1/commands_result/hold", payload)
    assert [effect.kind for effect in out if isinstance(effect, Log)] == ["forged"]
    assert len(out) == 1


SIGNED = Envelope(b"x", b"kidx", bytes(64)).plain()


@pytest.mark.parametrize(
    "plain",
    [
        [1, []],
        [2, [[1, SIGNED]]],
        [True, [[1, SIGNED]]],
        [1, {}],
        [1, [[1, SIGNED]] * (MOST_TOGETHER + 1)],
        [1, [[0, SIGNED]]],
        [1, [[251, SIGNED]]],
        [1, [[True, SIGNED]]],
        [1, [[1]]],
        [1, [[1, b"x"]]],
    ],
)
def test_what_is_no_words_together_is_refused(plain: Any, world: World) -> None:
    with pytest.raises(PayloadError) as refused:
        parse_together(cbor2.dumps(plain))
    assert refused.value.kind == "not_signed"
    assert [type(effect) for effect in world.hears("gs", "fog1/commands_result/hold", cbor2.dumps(plain))] == [Log]


def test_words_about_another_stations_command_and_of_drones_it_does_not_concern_are_left(plain_world: World) -> None:
    world = plain_world
    sent = world.send(Hold(), 1)
    for drone, gs_session, kinds in ((2, GS_SESSION, ["foreign_result"]), (1, GS_SESSION + 1, [])):
        words = (WordTogether(drone=drone, session=UAV_SESSION, stamp=1, word=Word.COMPLETED),)
        message = FogResultMessage(gs_session=gs_session, seq=sent.seq, session=FOG_SESSION, stamp=1, words=words)
        out = world.hears("gs", "fog1/commands_result/hold", encode(message))
        assert [getattr(effect, "kind", effect) for effect in out] == kinds


@pytest.mark.long
async def test_a_process_does_not_wait_for_its_tick_to_say_what_is_due(monkeypatch: pytest.MonkeyPatch) -> None:
    brokers = (BrokerAddress.parse(f"mqtt://127.0.0.1:{port}") for port in (1, 2))
    runner = ActivatorRunner(1, *brokers, Settings())
    left: list[Publish] = []
    monkeypatch.setattr(runner.links["cloud"], "publish", left.append)
    together = runner.activator.together
    word = ResultMessage(gs_session=GS_SESSION, seq=1, session=UAV_SESSION, stamp=1, word=Word.ACCEPTED)
    start_ms = runner.clock.now_ms()
    for drone in (1, 2):
        alone = channel().publish(f"fog1/drone{drone}/commands_result/arm", word)
        runner.carry_out(together.add("arm", drone, word, alone, start_ms))
    assert left == []
    await eventually(lambda: bool(left), "what waits leaves")
    assert runner.clock.now_ms() >= start_ms + TOGETHER_MS
    assert told(left) == [[(1, Word.ACCEPTED), (2, Word.ACCEPTED)]]


def test_a_list_of_psmi_leaves_behind_what_waits(bench: ActivatorBench) -> None:
    bench.command(to="commands")
    say(bench, 1, Word.ACCEPTED)
    deadline_ms, goto = bench.now_ms + 5000, Goto(47.0, 8.0, 10.0)
    ids = {"gs_session": GS_SESSION, "seq": 8, "executor_session": FOG_SESSION}
    wanted = SelectMessage(**ids, deadline_ms=deadline_ms, limit_s=0.5, mode=SelectMode.SELECT, command=goto)
    out = bench.cloud("commands/goto", wanted)
    topics = [effect.topic for effect in out if isinstance(effect, Publish)]
    assert topics[:2] == [f"{OF_FOG}arm", "fog1/PSMI"]
