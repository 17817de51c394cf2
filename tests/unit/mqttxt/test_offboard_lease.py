"""An offboard flight goes on while its station is there, through activator and fog, and ends soon after it is not."""

from __future__ import annotations

from typing import Any

import pytest

from mqttxt.drone.effects import Transmit
from mqttxt.protocol.commands import Offboard, Velocity
from mqttxt.protocol.messages import Word
from mqttxt.station.outcomes import Outcome
from tests.simulation.workbench import MODE, set_points
from tests.simulation.world import World, ack, heartbeat, landed, position

NORTH = Offboard(20.0, velocity=Velocity(2.0, 0.0, 0.0))


class Flight(World):
    """A drone in the air; every write to its autopilot is kept, and it does at once what its mode command says."""

    def in_offboard(self) -> Flight:
        self.autopilot_wrote: list[Any] = []
        self.start()
        self.pass_time(2000)
        self.autopilot(heartbeat(armed=True), position(10.0), landed(2))
        self.send(NORTH)
        self.pass_time(600, 50)
        self.autopilot(ack(MODE), heartbeat(armed=True, main=6, sub=0))
        return self

    def _write(self, effect: Transmit) -> None:
        self.autopilot_wrote.append(effect)
        super()._write(effect)

    def holds(self) -> bool:
        """Whether hold was commanded."""
        modes = [w.message for w in self.autopilot_wrote if getattr(w.message, "command", None) == MODE]
        return bool(modes) and modes[-1].param2 == 4.0

    def last_words(self) -> list[tuple[Word, str | None]]:
        return [(o.word, o.reason) for o in self.heard if isinstance(o, Outcome) and o.is_last]


def test_it_flies_its_whole_duration_while_the_station_is_there() -> None:
    world = Flight().in_offboard()
    world.pass_time(19_500, 50)
    assert not world.holds()
    assert len(set_points(world.autopilot_wrote)) == pytest.approx(400, abs=5)
    world.pass_time(1000, 50)
    assert world.holds()
    world.autopilot(ack(MODE), heartbeat(armed=True))
    assert world.last_words() == [(Word.COMPLETED, None)]


@pytest.mark.parametrize("lost", ["gs", "activator"])
def test_without_its_station_or_its_activator_it_holds_within_three_seconds(lost: str) -> None:
    world = Flight().in_offboard()
    world.pass_time(4000, 50)
    assert not world.holds()
    setattr(world, lost, Silent())
    world.pass_time(3100, 50)
    assert world.holds()


def test_without_the_fog_link_it_holds_within_three_seconds() -> None:
    world = Flight().in_offboard()
    world.pass_time(4000, 50)
    world.drop = {"init_connect"}
    world.uav.on_disconnected("fog", world.now_ms)
    world.pass_time(3100, 50)
    assert world.holds()


class Silent:
    """A process that is gone."""

    def __getattr__(self, name: str) -> Any:
        return lambda *arguments: []
