"""Two connections against what stalls, lies and comes back late (docs/protocol.md, section 19)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import pytest

from mqttxt.core.effects import Inbound, Publish
from mqttxt.drone.sensors.carrier import WINDOW, Carrier
from mqttxt.protocol.commands import Arm, Offboard, Velocity
from mqttxt.protocol.messages import Word
from mqttxt.protocol.readings import Reading, ReadingMessage
from mqttxt.station.outcomes import Outcome
from tests.simulation.two_links import LINKS, TwoLinks
from tests.simulation.world import ack, heartbeat, landed, position
from tests.unit.mqttxt.test_two_links import is_reachable, restart_activator, started

LTE, SAT = LINKS
ARM_DISARM, SET_MODE = 400, 176


def said(world: TwoLinks, command_id: object) -> list[tuple[Word, str | None]]:
    return [(o.word, o.reason) for o in world.heard if isinstance(o, Outcome) and o.id == command_id]


@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize("cuts", [(LTE, SAT), (SAT, LTE)])
def test_a_new_activator_is_taken_over_the_second_after_both_were_lost(signed: bool, cuts: tuple[str, str]) -> None:
    world = started(signed=signed)
    for link in cuts:
        world.cut("uav", link)
    restart_activator(world, LTE, SAT)
    world.connect("uav", SAT)
    world.pass_time(2000)
    assert is_reachable(world)
    assert "other_activator" not in {log.kind for log in world.logs}


def test_a_first_broker_that_says_old_leases_again_keeps_no_activator_away() -> None:
    world = started(signed=True)
    old = [each for _, each in world.over if each.topic == "drone1/init_connect" and each.link == LTE][-1]
    restart_activator(world, SAT)  # the first broker lets it in no more
    for _ in range(20):
        world.bonds["uav"].received(LTE, Inbound(old.topic, old.payload, 1))
        world.pass_time(5000)
    assert is_reachable(world)


def test_a_station_that_is_gone_controls_nothing_by_an_older_lease() -> None:
    world = started()
    world.pass_time(12_000)
    world.freeze("uav", SAT)
    world.pass_time(11_000)
    world.run("gs", world.gs.goodbye(world.now_ms))
    assert not world.uav.is_controlled(world.now_ms)
    world.held.pop(0)[1]()  # an older lease still comes, then the connection ends
    world.cut("uav", SAT)
    for _ in range(40):
        assert not world.uav.is_controlled(world.now_ms), "no heartbeats as a ground station (R6.12)"
        world.pass_time(250)


@dataclass
class Flown(TwoLinks):
    """Sees each mode that the autopilot is commanded."""

    modes: list[Any] = field(default_factory=list)

    def _write(self, effect: Any) -> None:
        if effect.message.get_type() == "COMMAND_LONG" and effect.message.command == SET_MODE:
            self.modes.append(effect)
        super()._write(effect)


@pytest.mark.parametrize("signed", [False, True])
def test_an_offboard_flight_does_not_end_by_an_older_lease(signed: bool) -> None:
    """The stuck connection gives back one message at a time, as a narrow one does."""
    world = Flown(signed=signed).start(1000)
    world.autopilot(heartbeat(armed=True), landed(2), position(10.0))
    command_id = world.send(Offboard(60.0, velocity=Velocity(1.0, 0.0, 0.0)))
    world.pass_time(1000)
    flying = heartbeat(armed=True, main=6, sub=0)
    world.autopilot(ack(SET_MODE), flying)

    commanded = len(world.modes)

    def fly(milliseconds: int) -> None:
        for _ in range(0, milliseconds, 50):
            world.pass_time(50)
            world.autopilot(flying if len(world.modes) == commanded else heartbeat(armed=True), position(10.0))

    fly(2000)
    world.freeze("uav", SAT)
    fly(8000)
    assert said(world, command_id) == [(Word.ACCEPTED, None)]
    held, world.held = world.held, []
    world.stuck.clear()
    for _, act in held:
        act()
        fly(50)
    assert said(world, command_id) == [(Word.ACCEPTED, None)]


@pytest.mark.parametrize("act", ["cut", "freeze"])
def test_readings_that_went_over_a_failed_connection_go_over_the_other(act: str) -> None:
    world = started()
    carrier = world.uav.carrier = Carrier(1, world.uav._channel, world.uav.topics)
    world.run("uav", carrier.on_fog_up(world.now_ms))
    world.freeze("uav", LTE)
    rows = [(n, Reading(1, "light", ReadingMessage(boot=1, seq=n, time_ms=1, value=n))) for n in range(1, WINDOW + 1)]
    world.run("uav", carrier.on_loaded(rows, WINDOW, world.now_ms))
    if act == "cut":
        world.cut("uav", LTE)
    world.pass_time(120_000)
    heard = {each.payload for who, each in world.sent if who == "activator" and "/sensor1/light" in each.topic}
    assert len(heard) == WINDOW


class Silent(TwoLinks):
    """The second broker acknowledges with 0 what nobody hears, as MQTT allows."""

    def _at_broker(self, name: str, publish: Publish) -> None:
        is_heard = publish.link != SAT or any(each[:2] == ("activator", SAT) for each in self.subscribed)
        if is_heard or publish.ref is None:
            super()._at_broker(name, publish)
        else:
            self.bonds[name].published(SAT, publish.ref, 0)


@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize("away_ms", [200, 3000])
def test_a_last_word_that_only_a_broker_without_the_activator_has_is_not_lost(signed: bool, away_ms: int) -> None:
    world = Silent(signed=signed).start(1000)
    world.cut("activator", SAT)
    world.pass_time(1000)
    command_id = world.send(Arm())
    world.autopilot(ack(ARM_DISARM))
    world.freeze("uav", LTE)
    world.autopilot(heartbeat(armed=True))
    world.pass_time(100)
    world.cut("uav", LTE)
    world.pass_time(away_ms)
    world.connect("uav", LTE)
    world.pass_time(60_000)
    assert said(world, command_id) == [(Word.ACCEPTED, None), (Word.COMPLETED, None)]
