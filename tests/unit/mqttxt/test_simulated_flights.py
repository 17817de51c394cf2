"""The roles fly the stand-in in simulated time, without any I/O, as PX4 and as ArduPilot."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt.activator.drones import CLOUD, FOG
from mqttxt.protocol.commands import Arm, Disarm, Goto, Hold, Land, Offboard, Return, Takeoff, Velocity
from mqttxt.protocol.messages import Word
from mqttxt.station.outcomes import Outcome
from sitl.fleet import DroneConfig
from sitl.outputs import Reply
from sitl.personalities import PERSONALITIES
from sitl.vehicle import Vehicle
from tests.simulation.world import World

STEP_MS = 20
HOME = (47.397742, 8.545594)
NORTH_100_M = Goto(HOME[0] + 0.0009, HOME[1], 12.0)


class Flight(World):
    """The world with an autopilot in it: what the UAV client says reaches it, and what it says the client."""

    def begin(self, like: str) -> Flight:
        self.vehicle = Vehicle(DroneConfig(1, quiet=True), ["px4-normal"], like=PERSONALITIES[like])
        self._downlink = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        self.gs.add_fogs([1])
        self.run("activator", self.activator.on_connected(FOG, self.now_ms))
        self.run("activator", self.activator.on_connected(CLOUD, self.now_ms))
        self.run("uav", self.uav.on_connected(FOG, self.now_ms))
        self.run("gs", self.gs.on_connected(CLOUD, self.now_ms))
        self.fly(3)
        return self

    def fly(self, seconds: float) -> None:
        for _ in range(round(seconds * 1000 / STEP_MS)):
            self.now_ms += STEP_MS
            now_s = self.now_ms / 1000
            self._hear([o.message for o in self.vehicle.advance(now_s) if isinstance(o, Reply)])
            self._hear(self.vehicle.streamed(0, now_s))
            for name in ("uav", "activator", "gs"):
                self.run(name, getattr(self, name).tick(self.now_ms))

    def outcome(self, command: Any, limit_s: float = 120) -> tuple[Word, str | None]:
        """What a command ends with."""
        sent = self.send(command)
        for _ in range(round(limit_s)):
            if (last := self.last_of(sent)) is not None:
                return last.word, last.reason
            self.fly(1)
        raise AssertionError(f"{command}: no last word in {limit_s:g} s")

    def set(self, **wanted: Any) -> None:
        """Past all links: `mode` is a pilot's hand."""
        _, out = self.vehicle.control({"set": wanted})
        self._hear([o.message for o in out if isinstance(o, Reply)])

    @property
    def mode(self) -> str:
        return str(self.vehicle.autopilot.mode.name)

    @property
    def up_m(self) -> float:
        return float(self.vehicle.autopilot.motion.position[2])

    def last_of(self, sent: Any) -> Outcome | None:
        """The last word on a command, None before it."""
        words = [o for o in self.heard if isinstance(o, Outcome) and o.id == sent]
        return words[-1] if words and words[-1].is_last else None

    def _hear(self, messages: list[Any]) -> None:
        for message in messages:
            for parsed in mavlink.MAVLink(None).parse_buffer(message.pack(self._downlink)) or ():
                self.autopilot(parsed)

    def _write(self, effect: Any) -> None:
        super()._write(effect)
        for parsed in (
            mavlink.MAVLink(None).parse_buffer(effect.message.pack(mavlink.MAVLink(None, 1, effect.source.component)))
            or ()
        ):
            self._hear([o.message for o in self.vehicle.handle(0, parsed) if isinstance(o, Reply)])


@pytest.fixture(params=PERSONALITIES)
def flight(request: pytest.FixtureRequest) -> Flight:
    return Flight().begin(request.param)


def test_every_command_is_flown_and_it_flies_again_after_a_landing(flight: Flight) -> None:
    place = Goto(HOME[0] + 0.0004, HOME[1], 14.0)
    velocity = Offboard(6.0, velocity=Velocity(3.0, 0.0, 0.0))
    first = (Arm(), Takeoff(10.0), place, velocity, Hold(), Land())
    second = (Arm(), Takeoff(5.0), Goto(HOME[0], HOME[1], 5.0), Return(), Arm(), Disarm())
    for command in (*first, *second):
        assert flight.outcome(command) == (Word.COMPLETED, None), command


def test_on_the_ground_nothing_but_a_takeoff_takes_off(flight: Flight) -> None:
    for command in (Takeoff(10.0), NORTH_100_M, Offboard(5.0, velocity=Velocity(0.0, 0.0, -1.0))):
        assert flight.outcome(command)[0] is Word.DENIED, command
    assert flight.outcome(Arm()) == (Word.COMPLETED, None)
    assert flight.outcome(NORTH_100_M)[0] is Word.DENIED
    assert flight.up_m == 0.0


def test_hold_stops_a_goto(flight: Flight) -> None:
    for command in (Arm(), Takeoff(10.0)):
        assert flight.outcome(command) == (Word.COMPLETED, None)
    goto = flight.send(NORTH_100_M)
    flight.fly(6)
    assert flight.vehicle.autopilot.motion.groundspeed_m_s > 3
    assert flight.outcome(Hold()) == (Word.COMPLETED, None)
    assert flight.vehicle.autopilot.motion.groundspeed_m_s < 1
    last = flight.last_of(goto)
    assert last is not None
    assert last.word is Word.SUPERSEDED


def test_each_kind_holds_in_the_mode_that_holds_without_sticks(flight: Flight) -> None:
    held = {"px4": "HOLD", "ardupilot": "BRAKE"}[flight.vehicle.like.name]
    for command in (Arm(), Takeoff(10.0), Hold()):
        assert flight.outcome(command) == (Word.COMPLETED, None)
    assert flight.mode == held
    assert flight.outcome(Offboard(3.0, velocity=Velocity(1.0, 0.0, 0.0))) == (Word.COMPLETED, None)
    assert flight.mode == held
    flight.fly(20)
    assert flight.up_m == pytest.approx(10.0, abs=0.5)


@pytest.mark.parametrize(
    "command",
    [Takeoff(40.0), NORTH_100_M, Land(), Return(), Offboard(60.0, velocity=Velocity(-1.0, 0.0, 0.0))],
    ids=lambda command: command.name,
)
def test_a_pilots_mode_ends_what_runs_and_stays(flight: Flight, command: Any) -> None:
    assert flight.outcome(Arm()) == (Word.COMPLETED, None)
    if not isinstance(command, Takeoff):
        assert flight.outcome(Takeoff(15.0)) == (Word.COMPLETED, None)
    sent = flight.send(command)
    flight.fly(4)
    assert flight.last_of(sent) is None
    pilots = {"px4": "altitude", "ardupilot": "alt_hold"}[flight.vehicle.like.name]
    flight.set(mode=pilots)
    flight.fly(1.2)
    last = flight.last_of(sent)
    assert last is not None
    assert (last.word, last.reason) == (Word.FAILED, "mode_changed")
    flight.fly(3)
    assert flight.mode == pilots.upper()


def test_a_takeoff_while_disarmed_leaves_nothing_that_the_next_arming_flies(flight: Flight) -> None:
    assert flight.outcome(Takeoff(10.0))[0] is Word.DENIED
    assert flight.outcome(Arm()) == (Word.COMPLETED, None)
    flight.fly(8)
    assert flight.up_m == 0.0


def test_arming_is_denied_where_it_is_not_healthy(flight: Flight) -> None:
    flight.set(healthy=False)
    flight.fly(2)
    reason = {"px4": "temporarily_rejected", "ardupilot": "autopilot: Arm: GPS 1: Bad fix"}[flight.vehicle.like.name]
    assert flight.outcome(Arm()) == (Word.DENIED, reason)
