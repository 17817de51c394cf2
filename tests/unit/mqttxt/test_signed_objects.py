"""What was said before is not what is now: who passes answers and rankings on cannot show an old one as new."""

from __future__ import annotations

import pytest

from mqttxt.core.channel import LATE_MS, SPAN_MS, Channel
from mqttxt.core.clock import stamp
from mqttxt.core.effects import Publish
from mqttxt.core.settings import Settings
from mqttxt.drone.plan_keeper import SURE_MS
from mqttxt.protocol.codec import encode
from mqttxt.protocol.commands import ClearPlan, SetParameter, UploadPlan
from mqttxt.protocol.messages import Word
from mqttxt.protocol.parameters import PARAMETERS, ParameterSet
from mqttxt.protocol.plans import PLAN, PlanItem, PlanList, PlanObject
from mqttxt.protocol.rankings import QodsMessage, Ranked
from mqttxt.station.transfers import Fetching, Staging
from tests.simulation.flight import Flight
from tests.simulation.signing import seal
from tests.simulation.world import FOG_SESSION, World

SOME = PlanObject(rally=(PlanItem(3, 5100, (0.0, 0.0, 0.0, 0.0), 473_979_220, 85_455_940, 15.0, True),))
NOTHING = PlanObject(mission=(), fence=(), rally=())
NAME = "MPC_XY_CRUISE"


class Repeating(Flight):
    """Who passes the drone's answers on keeps them. While `repeats`, no question arrives, and the old answers do."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.kept: list[Publish] = []
        self.repeats = False

    def route(self, name: str, publish: Publish) -> None:
        if publish.topic == "fog1/drone1/bulk" and self.repeats:
            for old in self.kept:
                super().route("activator", old)
            return
        if publish.topic == "fog1/drone1/bulk_answer":
            self.kept.append(publish)
        super().route(name, publish)

    def ask(self, kind: str, base: ParameterSet | None = None) -> Fetching:
        fetching = Fetching(self.gs.fog(1), 1, kind, base.hash if base is not None else None)
        self.run("gs", self.gs.transfers.begin(fetching, self.now_ms))
        self.fly(5)
        return fetching

    def upload(self) -> None:
        staging = Staging(self.gs.fog(1), 1, PLAN, SOME.packed())
        self.run("gs", self.gs.transfers.begin(staging, self.now_ms))
        self.fly(1)
        assert self.outcome(UploadPlan(staging.hash)) == (Word.COMPLETED, None)
        self.kept.clear()

    def answered(self, fetching: Fetching) -> bytes:
        """What came, once the questions arrive: the station goes on asking."""
        self.repeats = False
        for _ in range(20):
            if not fetching.is_over:
                self.fly(1)
        assert (fetching.is_over, fetching.error) == (True, None)
        return fetching.data


@pytest.mark.long
def test_an_older_plan_is_not_shown_as_the_one_of_now() -> None:
    flight = Repeating(signed=True).begin("px4")
    flight.upload()
    first = flight.answered(flight.ask(PLAN))
    assert PlanObject.unpacked(first).rally == SOME.rally
    assert flight.outcome(ClearPlan()) == (Word.COMPLETED, None)
    flight.repeats = True
    asked = flight.ask(PLAN)
    assert (asked.is_over, asked.data) == (False, b"")
    assert PlanObject.unpacked(flight.answered(asked)) == NOTHING


@pytest.mark.long
def test_older_parameters_are_not_shown_as_those_of_now() -> None:
    """Neither a set that was given before, nor that nothing has changed."""
    flight = Repeating(signed=True).begin("px4")
    before = ParameterSet.unpacked(flight.answered(flight.ask(PARAMETERS)))
    assert flight.answered(flight.ask(PARAMETERS, before)) == b""
    assert flight.outcome(SetParameter(NAME, 7.5)) == (Word.COMPLETED, None)
    for base in (None, before):
        flight.repeats = True
        asked = flight.ask(PARAMETERS, base)
        assert (asked.is_over, asked.data) == (False, b"")
        after = ParameterSet.unpacked(flight.answered(asked), base)
        assert after.parameters[NAME].value == 7.5


def test_a_plan_that_was_read_for_nobody_is_read_anew() -> None:
    """The drone loses its fog while it reads; who asks when it is back is not given what it has read then."""
    flight = Repeating(signed=True).begin("px4")
    flight.upload()
    lost = Fetching(flight.gs.fog(1), 1, PLAN)
    flight.run("gs", flight.gs.transfers.begin(lost, flight.now_ms))
    flight.run("uav", flight.uav.on_disconnected("fog", flight.now_ms))
    flight.fly(SURE_MS / 1000 + 1)
    lost.end()
    flight.vehicle.autopilot.plans.put(PlanList.RALLY, ())
    flight.run("uav", flight.uav.on_connected("fog", flight.now_ms))
    assert PlanObject.unpacked(flight.answered(flight.ask(PLAN))) == NOTHING


def ranking(world: World, drone: int) -> bytes:
    """What the activator says now: this drone alone is available."""
    ranked = Ranked(drone=drone, remaining_pct=90, max_groundspeed_m_s=10, age_s=1)
    message = QodsMessage(session=FOG_SESSION, stamp=stamp(world.now_ms), ranking=(ranked,))
    channel = Channel("cloud", "", Settings(), seal("fog1"))
    return channel.dated_payload("fog1/QoDS", encode(message), FOG_SESSION, world.now_ms)


def shown(world: World, payload: bytes) -> list[int]:
    """Which drones the station shows once this has come."""
    world.run("gs", world.hears("gs", "fog1/QoDS", payload))
    return [ranked.drone for ranked in world.gs.fogs[1].ranking]


def test_an_older_ranking_is_not_shown_as_the_one_of_now() -> None:
    """Nor when its stamp, after minutes in which a broker has passed on none, says nothing any more."""
    world = World(signed=True, drop={"QoDS"}).start(1000)
    first = ranking(world, 1)
    assert shown(world, first) == [1]
    world.pass_time(1000)
    assert shown(world, ranking(world, 2)) == [2]
    assert shown(world, first) == [2]
    world.pass_time(SPAN_MS + LATE_MS, step_ms=1000)
    assert shown(world, first) == [2]
    assert world.logs[-1].kind == "forged"
    assert shown(world, ranking(world, 3)) == [3]
