"""Several fleets as one: each has its own station, and nothing goes from one fleet to another (R2.4)."""

from __future__ import annotations

import asyncio
import logging
from pathlib import Path
from typing import Any

import pytest

from mqttxt import (
    Armed,
    BrokerRefused,
    ConfigurationError,
    Event,
    Fleets,
    FogUnreachable,
    Goto,
    GroundStation,
    Hold,
    Land,
    Outcome,
    PayloadError,
    PsmiList,
    Reachability,
    StateUpdate,
    StationEnded,
    Word,
)
from mqttxt.core.clock import SessionClock
from mqttxt.protocol.codec import decode
from mqttxt.protocol.control import DroneRecord, Registration
from mqttxt.protocol.messages import CommandMessage, ResultMessage
from mqttxt.protocol.rankings import Candidate, PsmiMessage, QodsMessage, SelectMessage, SelectMode
from mqttxt.security.access_list import Place, entries
from mqttxt.security.authority import Authority
from mqttxt.security.identity import Identity
from mqttxt.security.names import NodeName
from mqttxt.security.rights import Rights
from mqttxt.security.seal import Seal
from tests.simulation.world import matches
from tests.unit.mqttxt.test_sent_command import SESSION, Field, topics, turns

NEAR = Goto(47.4, 8.5, 20)
URL = "mqtt://127.0.0.1:1"


class TwoFleets:
    """Fleets `acme` and `north`, whose fogs 1 have a drone 1 each; what they hear and say is the test's."""

    def __init__(self) -> None:
        self.acme, self.north = Field(1, prefix="acme/"), Field(1, prefix="north/")
        self.fleets = Fleets(self.acme.gs, self.north.gs)
        for field in (self.acme, self.north):
            field.hear("fog1/drone1/reachable", DroneRecord(activator_session=SESSION, up=True, drone_session=5))

    def offer(self, field: Field, arrival_s: float, number: int = 0) -> None:
        """A fog's answer to the offer that it was asked for."""
        asked = decode(SelectMessage, field.sent[number].payload)
        best = Candidate(drone=1, arrival_s=arrival_s)
        head = {"gs_session": asked.gs_session, "seq": asked.seq, "session": SESSION, "stamp": 1}
        field.hear("fog1/PSMI", PsmiMessage(**head, listed=(best,), left_out=(), chosen=1, hold_until_ms=9000))

    def modes(self, field: Field, behind: int = 0) -> list[SelectMode]:
        """The steps of a choice that a fleet was sent, behind its first commands."""
        messages = [publish for publish in field.sent[behind:] if publish.topic.endswith("/goto")]
        return [decode(SelectMessage, publish.payload).mode for publish in messages]


async def heard(events: Any, count: int) -> list[Event]:
    return [await anext(events) for _ in range(count)]


async def test_a_command_goes_to_its_own_fleet_alone() -> None:
    two = TwoFleets()
    two.fleets.drone("acme/1").takeoff(10)
    assert (topics(two.acme), topics(two.north)) == (["acme/fog1/drone1/commands"], [])
    two.fleets.fog("north/1").broadcast(Land())
    assert (len(two.acme.sent), topics(two.north)) == (1, ["north/fog1/commands"])
    assert [(drone.fleet, drone.number, str(drone)) for drone in two.fleets.drones] == [
        ("acme", 1, "acme/1"),
        ("north", 1, "north/1"),
    ]


async def test_control_is_of_one_fleet() -> None:
    two = TwoFleets()
    taking = asyncio.ensure_future(two.fleets.drone("north/1").take_over())
    await turns()
    taken = [decode(Registration, p.payload) for p in two.north.published if p.topic.endswith("init_connect")][-1]
    assert taken.drones == (1,)
    mine = {"holder": "alpha", "holder_session": two.north.gs.session, "epoch": 1}
    two.north.hear("fog1/drone1/reachable", DroneRecord(activator_session=SESSION, up=True, drone_session=5, **mine))
    await taking
    assert [drone.is_controlled for drone in two.fleets.drones] == [False, True]
    assert len([p for p in two.acme.published if p.topic.endswith("init_connect")]) == 1


async def test_words_with_the_same_numbers_are_heard_in_their_own_fleet_alone() -> None:
    """Also a word that the broker of one fleet shows in the other: the ids are of another session."""
    two = TwoFleets()
    sent = two.fleets.drone("acme/1").arm(), two.fleets.drone("north/1").arm()
    two.acme.say(Word.FAILED)
    two.north.hear("fog1/drone1/commands_result/arm", _word_of(two.acme, Word.COMPLETED))
    two.north.say(Word.DENIED)
    first, second = await sent[0], await sent[1]
    assert (first.fleet, first.word, str(first)) == ("acme", Word.FAILED, "drone acme/1: arm failed")
    assert (second.fleet, second.word) == ("north", Word.DENIED)


def _word_of(field: Field, word: Word) -> ResultMessage:
    command = decode(CommandMessage, field.sent[0].payload)
    return ResultMessage(gs_session=command.gs_session, seq=command.seq, session=5, stamp=1, word=word)


async def test_events_of_all_fleets_name_theirs() -> None:
    two = TwoFleets()
    events = two.fleets.events()
    two.north.hear("fog1/QoDS", QodsMessage(session=SESSION, stamp=1, ranking=()))
    two.acme.hear("fog1/drone1/reachable", DroneRecord(activator_session=SESSION, up=False))
    ranking, gone = await heard(events, 2)
    assert (ranking.fleet, gone) == ("north", Reachability(1, 1, False, "acme"))


async def test_the_nearest_of_all_fleets_is_sent_and_the_others_reservation_released() -> None:
    two = TwoFleets()
    sent = two.fleets.best(NEAR)
    two.offer(two.acme, 20.0)
    two.offer(two.north, 10.0)
    await turns()
    assert two.modes(two.acme) == [SelectMode.OFFER]
    assert two.modes(two.north) == [SelectMode.OFFER, SelectMode.COMMIT]
    two.north.say(Word.ACCEPTED, sent=1)
    await turns()
    assert two.modes(two.acme) == [SelectMode.OFFER, SelectMode.RELEASE]
    two.north.say(Word.COMPLETED, sent=1)
    last = await sent
    assert (last.fleet, last.drone, last.word) == ("north", 1, Word.COMPLETED)
    lists = [said async for said in sent if isinstance(said, PsmiList)]
    assert sorted(said.fleet for said in lists) == ["acme", "north"]


async def test_a_hold_in_the_other_fleet_while_the_fogs_are_asked_ends_the_choice() -> None:
    two = TwoFleets()
    sent = two.fleets.best(NEAR)
    two.offer(two.acme, 20.0)
    two.offer(two.north, 10.0)
    two.fleets.drone("acme/1").hold()
    last = await sent
    assert (last.drone, last.word, last.reason) == (None, Word.DENIED, "cancelled")
    assert two.modes(two.north) == [SelectMode.OFFER, SelectMode.RELEASE]


async def test_a_fog_that_is_chosen_by_its_fleet_is_asked_there_alone() -> None:
    two = TwoFleets()
    two.fleets.best(NEAR, [two.fleets.fog("north/1")])
    assert two.modes(two.north) == [SelectMode.SELECT]
    assert two.acme.sent == []


async def test_leaving_releases_what_a_choice_has_reserved_in_every_fleet() -> None:
    two = TwoFleets()
    async with two.fleets:
        two.fleets.best(NEAR)
        two.offer(two.acme, 30.0)
        two.offer(two.north, 10.0)
        await turns()
    assert two.modes(two.acme) == [SelectMode.OFFER, SelectMode.RELEASE]
    with pytest.raises(StationEnded):
        two.fleets.drone("acme/1").hold()


@pytest.mark.parametrize("after", range(5))
@pytest.mark.parametrize("chooses", [False, True])
async def test_fleets_that_are_left_end_also_where_leaving_is_cancelled(after: int, chooses: bool) -> None:
    """Their stations would keep their leases, and with these the control of drones, for good."""
    two = TwoFleets()

    async def use() -> None:
        async with two.fleets:
            if chooses:
                two.fleets.best(NEAR)
            await asyncio.Event().wait()

    using = asyncio.create_task(use())
    await turns()
    using.cancel()
    await turns(after)
    using.cancel()
    await asyncio.wait({using})
    await turns(20)
    for field in (two.acme, two.north):
        with pytest.raises(StationEnded):
            field.runner.check()
        assert decode(Registration, field.published[-2].payload).lease_s == 0


async def test_a_fleet_whose_broker_refuses_it_leaves_the_other_one_flying(caplog: pytest.LogCaptureFixture) -> None:
    two = TwoFleets()
    events = two.fleets.events()
    caplog.set_level(logging.ERROR)
    await two.fleets.__aenter__()
    await turns()
    two.north.runner._fail(BrokerRefused("cloud: refused"))
    await turns(10)
    assert "fleet north: cloud: refused" in caplog.text
    with pytest.raises(BrokerRefused):
        two.fleets.drone("north/1").hold()
    two.fleets.drone("acme/1").send(Hold())
    assert topics(two.acme) == ["acme/fog1/drone1/commands"]
    two.fleets.best(NEAR)
    assert two.modes(two.acme, 1) == [SelectMode.OFFER], "who can be asked is asked"
    with pytest.raises(BrokerRefused):
        await two.fleets.wait_until(lambda: False, 5)
    two.acme.hear("fog1/drone1/reachable", DroneRecord(activator_session=SESSION, up=False))
    assert (await anext(events)).fleet == "acme"
    with pytest.raises(BrokerRefused):
        await two.fleets.__aexit__(None, None, None)
    with pytest.raises(BrokerRefused):
        await heard(events, 100)


async def test_what_is_missing_of_each_fleet_is_said() -> None:
    fleets = Fleets(*(GroundStation(URL, prefix=prefix) for prefix in ("acme", "north/eu/")))
    with pytest.raises(ConfigurationError, match="fleet 'west': expected one of acme, north/eu"):
        await fleets.connect({"west": [1]})
    async with fleets:
        with pytest.raises(FogUnreachable, match=r"fleet acme: fog 1: .*; fleet north/eu: fog 2: ") as missing:
            await fleets.connect({"acme": [1], "north/eu": [2]}, timeout_s=0.1)
    assert "127.0.0.1:1" in str(missing.value)


async def test_a_drone_is_where_it_is_reachable_and_one_that_two_fogs_have_is_none() -> None:
    field = Field(1, 2, prefix="acme/")
    fleets = Fleets(field.gs)
    with pytest.raises(FogUnreachable, match="drone acme/1: no fog that is connected knows it"):
        fleets.drone("acme/1")
    field.hear("fog1/drone1/reachable", DroneRecord(activator_session=SESSION, up=False))
    field.hear("fog2/drone1/reachable", DroneRecord(activator_session=SESSION, up=True, drone_session=5))
    assert fleets.drone("acme/1").fog == 2
    field.hear("fog1/drone1/reachable", DroneRecord(activator_session=SESSION, up=True, drone_session=6))
    with pytest.raises(FogUnreachable, match="fogs acme/1, acme/2 each say that it is reachable"):
        fleets.drone("acme/1")


@pytest.mark.parametrize(
    "prefixes",
    [
        *(("acme/", ""), ("acme/", "acme"), ("acme/", "Acme/"), ("acme/", "é/"), ("acme/", "7/"), ("acme/", "eu/7/")),
        *(("acme/", "a b/"), ("acme/", "ac\u0301me/"), ("\u0430cme/", "acme/"), ()),
    ],
)
def test_prefixes_that_do_not_tell_fleets_apart_are_refused(prefixes: tuple[str, ...]) -> None:
    stations = [GroundStation(URL, prefix=prefix) for prefix in prefixes]
    with pytest.raises(ConfigurationError) as refused:
        Fleets(*stations)
    assert len(refused.value.lines) == 1


def test_one_prefix_may_begin_with_another() -> None:
    fleets = Fleets(*(GroundStation(URL, prefix=prefix) for prefix in ("acme/", "acme/eu/", "acme/eu/1st")))
    assert [*fleets.stations] == ["acme", "acme/eu", "acme/eu/1st"]
    assert len({station.session for station in fleets.stations.values()}) == 3


def test_two_stations_of_one_session_are_refused() -> None:
    """Their commands would have the same ids, and their connections the same client id."""
    clock = SessionClock()
    with pytest.raises(ConfigurationError, match="session of another one"):
        Fleets(*(GroundStation(URL, prefix=prefix, name="alpha", clock=clock) for prefix in ("acme", "north")))


async def test_a_station_that_runs_already_is_not_one_of_several() -> None:
    field = Field(1, prefix="acme/")
    async with field.gs:
        with pytest.raises(StationEnded, match="entered once"):
            async with Fleets(field.gs, GroundStation(URL, prefix="north/")):
                pytest.fail("it was entered")


@pytest.mark.parametrize(
    ("one", "other"), [("", "acme/"), ("acme/", "acme/eu/"), ("acme/", "north/"), ("acme/fleet/", "acme/")]
)
def test_nothing_that_a_fleets_station_may_do_at_a_broker_is_of_another_fleet(one: str, other: str) -> None:
    """R11.8 with R2.2: what it publishes or hears has its own prefix, at a broker that both fleets' lists serve."""
    everything = Rights(None, take_over=True, observe=True, upload_plan=True, set_parameters=True)
    fogs = [NodeName.parse("fog1"), NodeName.parse("fog2")]
    of_both = [
        [
            entry
            for name in ("gs-ops", "fog1")
            for entry in entries(Place("cloud", 0, prefix), NodeName.parse(name), everything, fogs)
        ]
        for prefix in (one, other)
    ]
    assert [len(found) > 10 for found in of_both] == [True, True]
    topics = [entry.filter.replace("+", "fog1").replace("#", "fog1") for entry in of_both[1]]
    topics += [entry.filter.replace("+", "drone1").replace("#", "fog1/drone1") for entry in of_both[1]]
    assert [(e.filter, topic) for e in of_both[0] for topic in topics if matches(e.filter, topic)] == []


def test_what_is_signed_in_one_fleet_is_worth_nothing_in_another(tmp_path: Path) -> None:
    """R12.2: also where both authorities have one name, and the nodes too."""
    seals = []
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
        authority = Authority.create(tmp_path / folder / "acme", "acme")
        seals.append(Seal(Identity.load(authority.issue("gs-ops", Rights(None)))))
    signed = seals[0].sign("drone1/commands", b"arm", True).encode()
    assert seals[0].open("drone1/commands", signed, "gs-ops").payload == b"arm"
    with pytest.raises(PayloadError):
        seals[1].open("drone1/commands", signed, "gs-ops")


async def test_a_station_alone_names_no_fleet() -> None:
    field = Field(1, prefix="acme/")
    sent = field.fog().drone(1).arm()
    field.say(Word.COMPLETED)
    last = await sent
    assert (last.fleet, str(last), field.fog().fleet) == ("", "drone 1: arm completed", "")
    assert StateUpdate(1, 1, Armed(True), 1, 0).fleet == ""
    assert isinstance(last, Outcome)
