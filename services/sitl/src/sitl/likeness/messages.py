"""Cases of an autopilot's messages: its streams, their noise, its state in a flight, and its parameters."""

from __future__ import annotations

from . import figures
from .channel import Heard
from .pilot import Pilot
from .procedures import HEIGHT_M, Procedures, case, down, up

STREAMS_S = 20.0
HOVER_S = 40.0
MESSAGES: Procedures = {}


@case(MESSAGES, "idle, onboard link", counts=True)
def _idle_onboard(pilot: Pilot) -> None:
    heard = pilot.collect(STREAMS_S)
    pilot.case.streams = figures.streams(heard)
    pilot.case.numbers.update(figures.of(heard))


@case(MESSAGES, "idle, ground station's link", "gcs", counts=True)
def _idle_gcs(pilot: Pilot) -> None:
    pilot.case.streams = figures.streams(pilot.collect(STREAMS_S))


@case(MESSAGES, "idle, normal link", "normal", counts=True)
def _idle_normal(pilot: Pilot) -> None:
    pilot.case.streams = figures.streams(pilot.collect(STREAMS_S))


@case(MESSAGES, "unasked", counts=True)
def _unasked(pilot: Pilot) -> None:
    """The messages that it sends without a request, besides ATTITUDE, which is the clock."""
    for name in pilot.manners.asks.keys() - {"ATTITUDE"}:
        pilot.unask(name)
    pilot.wait(1)
    pilot.case.streams = figures.streams(pilot.collect(STREAMS_S))
    pilot.ask()


@case(MESSAGES, "hover", counts=True)
def _hover(pilot: Pilot) -> None:
    up(pilot)
    pilot.wait(2)
    heard = pilot.collect(HOVER_S)
    pilot.case.streams = figures.streams(heard)
    pilot.case.numbers.update(figures.of(heard))
    pilot.land()
    down(pilot)
    pilot.wait(3)
    pilot.case.numbers["battery_pct after landing"] = pilot.last["BATTERY_STATUS"].battery_remaining


@case(MESSAGES, "state messages of a flight", counts=True)
def _changes(pilot: Pilot) -> None:
    """How often home, battery and heading change from the start to the end of a short flight."""
    tap: list[Heard] = []
    pilot.tap(tap.append)
    up(pilot)
    pilot.goto(30, 30, HEIGHT_M)
    pilot.wait(15)
    pilot.set_mode("return")
    down(pilot)
    pilot.untap(tap.append)
    pilot.case.numbers.update(figures.changes(tap))


@case(MESSAGES, "parameters")
def _parameters(pilot: Pilot) -> None:
    for name in pilot.manners.parameters:
        value = pilot.parameter(name)
        if value is not None:
            pilot.case.numbers[name] = round(value, 4)
