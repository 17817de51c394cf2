"""A command is sent by the call, once: whatever its caller does, or does not do, with what the call returns."""

from __future__ import annotations

import asyncio
import gc
from functools import partial
from typing import Any

import pytest

from mqttxt import (
    Arm,
    BrokerRefused,
    ConfigurationError,
    Encoding,
    Fog,
    FogUnreachable,
    Goto,
    GroundStation,
    Location,
    Outcome,
    Outcomes,
    PayloadError,
    PsmiList,
    SentCommand,
    StateUpdate,
    StationEnded,
    Takeoff,
    Word,
)
from mqttxt.cli import advice
from mqttxt.core.clock import Beacon, RemoteClock, SessionClock
from mqttxt.core.effects import Inbound, Publish, Subscribe
from mqttxt.errors import SigningDiffers
from mqttxt.protocol.codec import decode, encode
from mqttxt.protocol.control import DroneRecord, Registration
from mqttxt.protocol.messages import (
    BeaconMessage,
    CommandMessage,
    FogPresence,
    FogResultMessage,
    ResultMessage,
    RosterEntry,
)
from mqttxt.protocol.rankings import Candidate, PsmiMessage, SelectMessage, SelectMode
from mqttxt.protocol.state_payload import StampedState, encode_state
from mqttxt.protocol.states import AutopilotText, Severity
from mqttxt.security.cose import Envelope
from mqttxt.station import heard
from mqttxt.station.drone_view import HeardState
from mqttxt.station.readiness import missing

SESSION = 0x22
NEAR = Goto(47.4, 8.5, 20)


class Field:
    """A ground station whose connection to the cloud broker, and whose fogs, are the test."""

    def __init__(self, *fogs: int, prefix: str = "") -> None:
        self.prefix = prefix
        self.gs = GroundStation("mqtt://127.0.0.1:1", name="alpha", prefix=prefix)
        self.runner = self.gs._runner
        self.runner.links["cloud"] = self  # type: ignore[assignment]
        self.address = "mqtt://127.0.0.1:1"
        self.failure: str | None = None
        self.published: list[Publish] = []
        self.given_up: list[str] = []
        self._stamp = -1
        self.runner.connected("cloud")
        self.runner.carry_out(self.runner.station.add_fogs(fogs))
        for fog in fogs:
            self.hear(f"fog{fog}/reachable", FogPresence(session=SESSION, up=True))
            (registration,) = [p for p in self.published if p.topic == f"{prefix}fog{fog}/init_connect"]
            nonce = decode(Registration, registration.payload).nonce
            self.hear(f"fog{fog}/clock", BeaconMessage(session=SESSION, now_ms=0, nonce=nonce, held_ms=0))

    @property
    def sent(self) -> list[Publish]:
        """The commands among what was published."""
        return [publish for publish in self.published if "/commands" in publish.topic]

    async def run(self) -> None:
        await asyncio.Event().wait()

    async def close(self) -> None:
        """The broker has taken everything already."""

    def give_up(self, reason: str) -> None:
        self.given_up.append(reason)

    def publish(self, effect: Publish) -> None:
        self.published.append(effect)

    def subscribe(self, effect: Subscribe) -> None:
        self.runner.subscribed(effect)

    def hear(self, topic: str, message: Any) -> None:
        self.runner.received("cloud", Inbound(self.prefix + topic, encode(message), 1))

    def hear_place(self, north_deg: float = 47.4) -> Location:
        """Drone 1 says where it is."""
        state = Location(north_deg, 8.5, 500.0, 12.0)
        self._hear_state(state)
        return state

    def hear_text(self, text: str) -> None:
        """Drone 1 passes on a text of its autopilot."""
        self._hear_state(AutopilotText(Severity.INFO, text))

    def _hear_state(self, state: Location | AutopilotText) -> None:
        self._stamp += 1
        payload = encode_state(StampedState(state, self._stamp, self._stamp), Encoding.CBOR)
        self.runner.received("cloud", Inbound(f"fog1/drone1/state/{state.name}", payload))

    def fog(self, number: int = 1) -> Fog:
        return self.gs.fog(number)

    def say(self, word: Word, sent: int = 0, drone: int = 1, fog: int = 1, **more: Any) -> None:
        """A drone's word on the command that was the station's `sent`-th."""
        kind = CommandMessage if self.sent[sent].topic.endswith("/commands") else SelectMessage
        command = decode(kind, self.sent[sent].payload)
        fields = {"gs_session": command.gs_session, "seq": command.seq, "session": 5, "stamp": 1, "word": word}
        topic = f"fog{fog}/drone{drone}/commands_result/{command.command.name}"
        self.hear(topic, ResultMessage(**fields, **more))

    def answer_fog(self, fog: int = 1, **fields: Any) -> None:
        command = decode(CommandMessage, self.sent[-1].payload)
        head = {"gs_session": command.gs_session, "seq": command.seq, "session": SESSION, "stamp": 1}
        self.hear(f"fog{fog}/commands_result/{command.command.name}", FogResultMessage(**head, **fields))


@pytest.fixture
async def field() -> Field:
    """With one fog."""
    return Field(1)


async def turns(count: int = 5) -> None:
    """Let what is ready run."""
    for _ in range(count):
        await asyncio.sleep(0)


async def fail_at_the_first(sent: SentCommand[Outcome, Outcome]) -> None:
    async for _ in sent:
        raise ZeroDivisionError


def topics(field: Field) -> list[str]:
    return [publish.topic for publish in field.sent]


async def test_the_call_sends_and_an_await_gives_the_last_word(field: Field) -> None:
    sent = field.fog().drone(1).takeoff(10)
    assert topics(field) == ["fog1/drone1/commands"]
    assert decode(CommandMessage, field.sent[0].payload).command == Takeoff(10)
    field.say(Word.ACCEPTED)
    field.say(Word.COMPLETED)
    outcome = await sent
    assert outcome.completed
    assert (outcome.drone, outcome.word, outcome.is_last) == (1, Word.COMPLETED, True)


async def test_several_awaits_of_one_command_send_it_once_and_get_the_same_answer(field: Field) -> None:
    sent = field.fog().drone(1).arm()
    waiting = [asyncio.ensure_future(sent), asyncio.ensure_future(sent)]
    await turns()
    field.say(Word.FAILED, reason="autopilot")
    assert await waiting[0] is await waiting[1] is await sent
    assert not (await sent).completed
    assert len(field.sent) == 1


async def test_who_makes_a_task_of_it_wrongly_is_told_that_it_was_sent_and_how_to(field: Field) -> None:
    sent = field.fog().drone(1).arm()
    wrongly: Any = asyncio.create_task
    with pytest.raises(TypeError, match=r"the command was sent; asyncio\.ensure_future"):
        wrongly(sent)
    assert topics(field) == ["fog1/drone1/commands"]
    task = asyncio.ensure_future(sent)
    field.say(Word.COMPLETED)
    assert (await task).completed


async def test_a_cancelled_await_leaves_the_command_as_it_is(field: Field) -> None:
    sent = field.fog().drone(1).land()
    other = asyncio.ensure_future(sent)
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(0.01):
            await sent
    assert len(field.sent) == 1
    field.say(Word.COMPLETED)
    assert (await sent).completed
    assert (await other).completed
    assert len(field.sent) == 1


async def test_every_iteration_begins_with_the_first_word_also_behind_an_exception(field: Field) -> None:
    sent = field.fog().drone(1).send(Goto(47.4, 8.5, 10))
    field.say(Word.IN_PROGRESS, percent=40)
    with pytest.raises(ZeroDivisionError):
        await fail_at_the_first(sent)
    field.say(Word.ACCEPTED)
    async for outcome in sent:
        assert outcome.word is Word.IN_PROGRESS
        break
    field.say(Word.COMPLETED)
    for _ in range(2):
        assert [outcome.word async for outcome in sent] == [Word.IN_PROGRESS, Word.ACCEPTED, Word.COMPLETED]
    assert len(field.sent) == 1


async def test_a_broadcast_that_nobody_awaits_is_sent(field: Field) -> None:
    field.fog().broadcast(Arm())
    gc.collect()
    assert topics(field) == ["fog1/commands"]


async def test_a_broadcast_is_completed_where_every_drone_has_done_it_and_there_is_one() -> None:
    for words, completed in (
        ({1: Word.COMPLETED, 2: Word.COMPLETED}, True),
        ({1: Word.COMPLETED, 2: Word.DENIED}, False),
        ({}, False),
    ):
        field = Field(1)
        sent = field.fog().broadcast(Arm())
        field.answer_fog(roster=tuple(RosterEntry(drone=drone) for drone in words))
        for drone in sorted(words, reverse=True):
            field.say(words[drone], drone=drone)
        outcomes = await sent
        assert isinstance(outcomes, Outcomes)
        assert [(outcome.drone, outcome.word) for outcome in outcomes] == list(words.items())
        assert outcomes.completed is completed


async def test_a_broadcast_that_the_fog_refuses_is_one_answer_without_a_drone(field: Field) -> None:
    sent = field.fog().broadcast(Arm())
    field.answer_fog(denied="no_drones")
    (outcome,) = await sent
    assert (outcome.drone, outcome.word, outcome.reason) == (None, Word.DENIED, "no_drones")


@pytest.mark.parametrize(
    ("call", "error"),
    [
        (lambda fog: fog.drone(1).goto(float("nan"), 8.5, 10), PayloadError),
        (lambda fog: fog.drone(1).arm(ttl_s=61), ConfigurationError),
        (lambda fog: fog.drone(1).arm(limit_s=0), ConfigurationError),
        (lambda fog: fog.broadcast(NEAR), ConfigurationError),
        (lambda fog: fog.best(Arm()), ConfigurationError),
        (lambda fog: fog.drone(251), ConfigurationError),
        (lambda fog: fog.drone(1.5), ConfigurationError),
        (lambda fog: fog.drone(True), ConfigurationError),
        (lambda fog: fog.drone("1"), ConfigurationError),
    ],
)
async def test_what_cannot_be_is_refused_by_the_call_and_nothing_is_sent(call: Any, error: type[Exception]) -> None:
    field = Field(1)
    with pytest.raises(error):
        call(field.fog())
    assert field.sent == []


@pytest.mark.parametrize(
    ("given", "error"),
    [
        ({"encoding": "json"}, "encoding 'json': expected Encoding.CBOR or Encoding.JSON"),
        ({"control": None}, "control None: expected True, False or drones' numbers, as [1, 3]"),
        ({"control": [1.0]}, "drone 1.0: expected a whole number from 1 to 250"),
        ({"control": "12"}, "drone '1': expected a whole number from 1 to 250"),
    ],
)
def test_a_parameter_of_a_station_that_cannot_be_is_named(given: dict[str, Any], error: str) -> None:
    with pytest.raises(ConfigurationError) as refused:
        GroundStation("mqtt://127.0.0.1:1", **given)
    assert str(refused.value) == error


@pytest.mark.parametrize(("fog", "timeout_s"), [(2, -1.0), (2.0, 5.0), (0, 5.0)])
async def test_a_station_that_is_told_to_connect_wrongly_takes_part_in_no_further_fog(
    field: Field, fog: Any, timeout_s: float
) -> None:
    async with field.gs as gs:
        with pytest.raises(ConfigurationError, match="expected"):
            await gs.connect([fog], timeout_s)
        assert [each.number for each in gs.fogs] == [1]


async def test_without_a_live_activator_the_call_says_so_and_nothing_is_sent(field: Field) -> None:
    fog = field.fog()
    field.hear("fog1/reachable", FogPresence(session=SESSION, up=False))
    for call in (lambda: fog.broadcast(Arm()), lambda: fog.drone(1).arm(), lambda: field.gs.best(NEAR)):
        with pytest.raises(FogUnreachable, match=r"fog 1: no live activator; .* was not sent"):
            call()
    with pytest.raises(FogUnreachable, match="fog 1: no live activator; control was not taken"):
        await fog.take_over()
    assert field.sent == []


async def test_a_drone_is_that_of_the_fog_that_reaches_it() -> None:
    field = Field(1, 2)
    with pytest.raises(FogUnreachable, match="drone 1: no fog that is connected knows it"):
        field.gs.drone(1)
    field.hear("fog1/drone1/reachable", DroneRecord(activator_session=SESSION, up=False))
    assert field.gs.drone(1).fog == 1
    reached = DroneRecord(activator_session=SESSION, up=True, drone_session=5)
    field.hear("fog2/drone1/reachable", reached)
    assert field.gs.drone(1).fog == 2
    field.hear("fog1/drone1/reachable", reached)
    with pytest.raises(FogUnreachable, match="drone 1: fogs 1, 2 each say that it is reachable"):
        field.gs.drone(1)
    with pytest.raises(ConfigurationError, match="drone 251"):
        field.gs.drone(251)


async def test_some_drones_of_a_fog_are_taken_over_by_its_fog_and_by_the_station(field: Field) -> None:
    for take_over in (field.fog().take_over, partial(field.gs.take_over, 1)):
        before = len(field.published)
        with pytest.raises(FogUnreachable, match="fog 1"):
            await take_over((2, 3), 0.05)
        taken = [decode(Registration, publish.payload) for publish in field.published[before:]]
        assert [registration.drones for registration in taken][:1] == [(2, 3)]


async def test_a_drone_of_which_only_an_old_record_is_there_keeps_no_takeover_waiting(field: Field) -> None:
    field.hear("fog1/drone3/reachable", DroneRecord(activator_session=7, up=True, drone_session=4))
    field.hear("fog1/drone1/reachable", DroneRecord(activator_session=SESSION, up=True, drone_session=5))
    taking = asyncio.ensure_future(field.fog().take_over(timeout_s=5))
    await turns()
    mine = DroneRecord(
        activator_session=SESSION, up=True, drone_session=5, holder="alpha", holder_session=field.gs.session, epoch=1
    )
    field.hear("fog1/drone1/reachable", mine)
    await turns(10)
    assert taking.done()
    await taking


async def test_before_connect_every_call_gives_its_documented_error() -> None:
    gs = GroundStation("mqtt://127.0.0.1:1")
    with pytest.raises(FogUnreachable, match="no fog is connected; goto was not sent"):
        gs.best(NEAR)
    with pytest.raises(FogUnreachable, match="fog 1: connect to it first; goto was not sent"):
        gs.best(NEAR, [1])
    with pytest.raises(FogUnreachable, match="fog 1: connect to it first"):
        await gs.take_over(1)
    with pytest.raises(FogUnreachable, match="fog 1: connect to it first"):
        gs.fog(1)
    with pytest.raises(ConfigurationError, match="async with"):
        await gs.connect([1])


async def test_events_are_kept_from_the_call_on(field: Field) -> None:
    events = field.gs.events()
    state = field.hear_place()
    update = await anext(events)
    assert isinstance(update, StateUpdate)
    assert update.state == state


async def test_a_slow_reader_of_events_loses_no_word_and_keeps_of_each_state_the_newest(
    field: Field, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(heard, "MOST_WAITING", 10)
    events = field.gs.events()
    sent = field.fog().drone(1).arm()
    field.say(Word.ACCEPTED)
    for at in range(1000):
        field.hear_place(north_deg=at / 100)
        if at in (3, 500):
            field.hear_text(f"text {at}")
    field.say(Word.COMPLETED)
    assert (await sent).completed
    waiting = list(events._record.said)
    assert len(waiting) < 20
    assert [str(event) for event in waiting if isinstance(event, Outcome)] == [
        "drone 1: arm accepted",
        "drone 1: arm completed",
    ]
    states = [event.state for event in waiting if isinstance(event, StateUpdate)]
    assert [state.text for state in states if isinstance(state, AutopilotText)] == ["text 3", "text 500"]
    places = [state.latitude_deg for state in states if isinstance(state, Location)]
    assert places[-1] == pytest.approx(9.99)
    assert places == sorted(places)
    assert await anext(events) == waiting[0]


async def test_a_stream_of_events_that_nobody_holds_is_forgotten(field: Field) -> None:
    field.gs.events()
    kept = field.gs.events()
    gc.collect()
    assert len(field.runner._streams) == 1
    assert kept is aiter(kept)


async def test_a_state_comes_by_its_type_with_its_age(field: Field) -> None:
    drone = field.fog().drone(1)
    assert drone.location is None
    assert drone.states == {}
    state = field.hear_place()
    known = drone.location
    assert known is not None
    assert known.state == state
    assert known.age_ms is not None
    assert 0 <= known.age_ms < 60_000
    assert drone.state(Location) is not None
    assert set(drone.states) == {"location"}


def state_of_a_clock_that_is_not_known(received_ms: int) -> HeardState:
    """Said at 1 s of the relay's clock, and heard before the station's question was answered."""
    return HeardState(StampedState(Location(47.4, 8.5, 500.0, 12.0), 100, 100), received_ms, RemoteClock(SESSION))


def test_a_state_whose_age_is_asked_for_late_is_no_younger_than_its_arrival() -> None:
    """Stamps come round after 655.36 s."""
    known = state_of_a_clock_that_is_not_known(received_ms=1000)
    assert known.clock is not None
    assert known.age_ms(1000) is None
    known.clock.observe(Beacon(SESSION, 1500, 7, 0), 1500, 1490)
    for asked_ms in (661_000, 700_000):
        age_ms = known.age_ms(asked_ms)
        assert age_ms is not None
        assert asked_ms - 1000 <= age_ms < asked_ms + 2000


async def test_what_waited_while_the_process_stood_still_for_minutes_is_not_taken(field: Field) -> None:
    """Stamps would give it the age and the order of a new state."""
    field.runner.ticked_ms -= 200_000
    field.hear_place()
    assert field.given_up == ["this process stood still, and what it has received is old"]
    assert field.fog().drone(1).states == {}


@pytest.mark.parametrize(("still_ms", "times"), [(200_000, 1), (20_000, 0)])
async def test_after_minutes_of_standing_still_it_connects_anew_also_where_nothing_waited(
    still_ms: int, times: int
) -> None:
    """What the network has kept meanwhile comes after the first tick."""
    field = Field(1)
    field.runner.ticked_ms -= still_ms
    field.runner.stood_still()
    assert len(field.given_up) == times


async def test_a_drone_is_not_reachable_while_nothing_is_heard_of_its_fog(field: Field) -> None:
    """A program may ask before its station, which stood still, has noticed."""
    field.hear("fog1/drone1/reachable", DroneRecord(activator_session=SESSION, up=True, drone_session=5))
    drone = field.fog().drone(1)
    assert drone.is_reachable
    times_ns = [0, (field.runner.clock.now_ms() + 40_000) * 1_000_000]
    field.runner.clock = SessionClock(lambda: times_ns.pop(0))
    assert not drone.is_reachable


async def test_connect_names_what_each_fog_lacks(field: Field) -> None:
    view = field.runner.station.fogs[1]
    assert missing(field.runner, view) == "its activator has not confirmed the registration"
    view.up = False
    assert missing(field.runner, view) == "no activator is at mqtt://127.0.0.1:1"
    birth = FogPresence(session=7, up=True)
    plain, signed = encode(birth), Envelope(encode(birth), bytes(4), bytes(64)).encode()
    field.runner.received("cloud", Inbound("fog1/reachable", signed))
    advice = "does not; expected `signed` beside `identity`"
    assert missing(field.runner, view) == f"its activator signs messages and this station {advice}"
    field.runner.received("cloud", Inbound("fog1/reachable", plain))
    assert view.up
    view.up = False
    assert missing(field.runner, view) == "no activator is at mqtt://127.0.0.1:1"
    view.subscribed = False
    assert missing(field.runner, view) == "mqtt://127.0.0.1:1 has not granted the subscription"
    field.runner.disconnected("cloud")
    field.failure = "Connection refused"
    assert missing(field.runner, view) == "no connection to mqtt://127.0.0.1:1 (Connection refused)"


async def test_a_fog_that_signs_is_told_from_one_that_is_not_there(field: Field) -> None:
    """By its type: the command adds no advice about addresses then."""
    field.hear("fog1/reachable", FogPresence(session=SESSION, up=False))
    signed = Envelope(encode(FogPresence(session=7, up=True)), bytes(4), bytes(64)).encode()
    field.runner.received("cloud", Inbound("fog1/reachable", signed))
    async with field.gs:
        with pytest.raises(SigningDiffers, match="this station does not; expected `signed` beside `identity`"):
            await field.gs.connect([1], 0.01)
        with pytest.raises(SigningDiffers) as told:
            await advice.connect(field.gs, {"": [1]}, 0.01)
    assert "--cloud" not in str(told.value)


@pytest.mark.long
async def test_connect_to_a_broker_that_is_not_there_says_why() -> None:
    async with GroundStation("mqtt://127.0.0.1:1") as gs:
        with pytest.raises(FogUnreachable) as failure:
            await gs.connect([1, 2], timeout_s=0.5)
    lacks = "no connection to mqtt://127.0.0.1:1 (Connection refused)"
    assert str(failure.value) == f"fog 1: {lacks}; fog 2: {lacks} (waited 0.5 s)"


# A choice across fogs


def offer(field: Field, fog: int, drone: int | None, arrival_s: float = 10.0) -> None:
    """A fog's answer to the offer that it was asked for last."""
    publish = [p for p in field.sent if p.topic == f"fog{fog}/commands/goto"][-1]
    asked = decode(SelectMessage, publish.payload)
    listed = (Candidate(drone=drone, distance_m=10.0, arrival_s=arrival_s),) if drone is not None else ()
    held = {"chosen": drone, "hold_until_ms": 60_000} if drone is not None else {}
    head = {"gs_session": asked.gs_session, "seq": asked.seq, "session": SESSION, "stamp": 1}
    field.hear(f"fog{fog}/PSMI", PsmiMessage(**head, listed=listed, left_out=(), **held))


def modes(field: Field) -> list[tuple[str, SelectMode]]:
    """What was asked of which fog."""
    return [(publish.topic, decode(SelectMessage, publish.payload).mode) for publish in field.sent]


OFFERED = [("fog1/commands/goto", SelectMode.OFFER), ("fog2/commands/goto", SelectMode.OFFER)]


async def test_a_choice_goes_on_whether_or_not_somebody_waits_for_it() -> None:
    field = Field(1, 2)
    sent = field.gs.best(NEAR)
    assert modes(field) == OFFERED
    offer(field, 1, 1, arrival_s=20.0)
    offer(field, 2, 4)
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(0.01):
            await sent
    await turns()
    assert modes(field) == [*OFFERED, ("fog2/commands/goto", SelectMode.COMMIT)]
    field.say(Word.ACCEPTED, sent=2, drone=4, fog=2)
    await turns()
    assert modes(field)[3:] == [("fog1/commands/goto", SelectMode.RELEASE)]
    field.say(Word.COMPLETED, sent=2, drone=4, fog=2)
    outcome = await sent
    assert (outcome.fog, outcome.drone, outcome.completed) == (2, 4, True)
    assert [event.fog async for event in sent if isinstance(event, PsmiList)] == [1, 2]


@pytest.mark.parametrize("others", [Word.DENIED, Word.EXPIRED])
@pytest.mark.parametrize("its", [Word.COMPLETED, Word.UNCONFIRMED])
async def test_the_answer_of_a_choice_is_the_drones_that_has_the_command(field: Field, its: Word, others: Word) -> None:
    """R7.8: a restarted activator asks every drone, and the one that has the command is not the last to answer."""
    sent = field.gs.best(NEAR)
    select = decode(SelectMessage, field.sent[0].payload)
    head = {"gs_session": select.gs_session, "seq": select.seq, "session": SESSION, "stamp": 1}
    for drone in (1, 2):
        field.hear("fog1/PSMI", PsmiMessage(**head, listed=(), left_out=(), chosen=drone))
    field.say(its, drone=2)
    field.say(others, drone=1)
    outcome = await sent
    assert (outcome.drone, outcome.word) == (2, its)


async def test_fogs_that_answer_no_offer_are_named_and_nobody_is_sent() -> None:
    field = Field(1, 2)
    sent = field.gs.best(NEAR, ttl_s=0.01)
    with pytest.raises(FogUnreachable, match=r"goto: no fog answered within 0\.01 s; no drone was sent"):
        await sent
    assert modes(field) == OFFERED


# The end of the station


async def test_who_waits_for_a_command_hears_that_the_station_was_left_and_a_later_call_too(field: Field) -> None:
    drone = field.fog().drone(1)
    async with field.gs:
        sent = drone.arm()
        waiting = asyncio.ensure_future(sent)
        await turns()
    assert len(field.sent) == 1
    for waits in (waiting, sent):
        with pytest.raises(StationEnded):
            await waits
    with pytest.raises(StationEnded):
        drone.land()
    with pytest.raises(StationEnded):
        await field.gs.take_over(1)
    with pytest.raises(StationEnded):
        await field.gs.__aenter__()
    with pytest.raises(StationEnded):
        await field.gs.connect([1])
    assert [event async for event in field.gs.events()] == []
    assert len(field.sent) == 1


async def test_the_error_that_ended_a_station_does_not_grow_while_a_program_tries_again(field: Field) -> None:
    """Each frame of its traceback would keep what its caller had."""
    await field.gs.__aenter__()
    await turns()
    sent = field.fog().drone(1).arm()
    field.runner._fail(BrokerRefused("cloud: refused"))
    await turns(20)
    calls, waits = set(), set()
    for _ in range(3):
        with pytest.raises(BrokerRefused) as call:
            field.fog().drone(1).arm()
        calls.add(len(call.traceback))
    for _ in range(3):
        with pytest.raises(BrokerRefused) as wait:
            await sent
        waits.add(len(wait.traceback))
    assert (len(calls), len(waits)) == (1, 1)
    with pytest.raises(BrokerRefused):
        await field.gs.__aexit__(None, None, None)


async def test_a_choice_releases_what_it_holds_when_the_station_is_left() -> None:
    field = Field(1, 2)
    async with field.gs:
        sent = field.gs.best(NEAR)
        offer(field, 1, 1, arrival_s=20.0)
        offer(field, 2, 4)
        await turns(10)
    assert modes(field) == [
        *OFFERED,
        ("fog2/commands/goto", SelectMode.COMMIT),
        ("fog1/commands/goto", SelectMode.RELEASE),
    ]
    with pytest.raises(StationEnded):
        await sent


# Other threads and event loops


async def test_another_thread_or_loop_is_refused_and_nothing_is_sent(field: Field) -> None:
    """A wait there would never be woken, and a command could leave amid another one's bytes."""
    drone = field.fog().drone(1)

    async def in_another_loop() -> None:
        drone.takeoff(10)

    async def waits_there() -> None:
        await field.gs.wait_until(lambda: False, 60)

    async with field.gs:
        for call in (drone.land, lambda: asyncio.run(in_another_loop()), lambda: asyncio.run(waits_there())):
            with pytest.raises(ConfigurationError, match="another thread or event loop; expected the one that entered"):
                await asyncio.to_thread(call)
        assert field.sent == []
        drone.land()
    assert len(field.sent) == 1
