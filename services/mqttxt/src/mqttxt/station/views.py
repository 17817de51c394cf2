"""Fogs and drones as their ground station sees them: what is known of them, and the commands to them."""

from __future__ import annotations

from collections.abc import AsyncIterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..core.clock import DEFAULT_TTL_MS
from ..protocol.commands import Command
from ..protocol.rankings import Ranked
from ..protocol.states import State
from .fog import FogView
from .outcomes import Outcome, PsmiList, SensorReading

if TYPE_CHECKING:
    from .ground_station import GroundStation


@dataclass(frozen=True)
class KnownState:
    """A state as last heard; `age_ms` is an upper bound of its age now, None where the fog has no clock of it."""

    state: State
    age_ms: int | None


class Fog:
    """One fog, as its ground station sees it."""

    def __init__(self, station: GroundStation, view: FogView) -> None:
        self._station = station
        self._view = view

    @property
    def number(self) -> int:
        return self._view.number

    @property
    def is_live(self) -> bool:
        """Whether its activator is there: it says so, and its beacons keep coming."""
        return self._view.is_live(self._station.clock.now_ms())

    @property
    def drones(self) -> list[Drone]:
        """Every drone that the fog knows, by number."""
        numbers = {*self._view.drones, *self._view.configured}
        return [Drone(self._station, self._view, number) for number in sorted(numbers)]

    def drone(self, number: int) -> Drone:
        return Drone(self._station, self._view, number)

    @property
    def ranking(self) -> tuple[Ranked, ...]:
        """QoDS: the available drones, best first, as the activator last said."""
        return self._view.ranking

    async def take_over(self, timeout_s: float = 10.0) -> None:
        """Take control of all drones of the fog, whoever has it; errors as `GroundStation.take_over`."""
        await self._station.take_over(self.number, timeout_s=timeout_s)

    def best(
        self, command: Command, *, ttl_s: float = DEFAULT_TTL_MS / 1000, limit_s: float | None = None
    ) -> AsyncIterator[Outcome | PsmiList]:
        """Send a command to the drone of this fog that arrives first (PSMI); errors as `broadcast`."""
        return self._station.best(command, [self.number], ttl_s=ttl_s, limit_s=limit_s)

    def broadcast(
        self, command: Command, *, ttl_s: float = DEFAULT_TTL_MS / 1000, limit_s: float | None = None
    ) -> AsyncIterator[Outcome]:
        """Send a command to every drone of the fog; yields each one's words up to its last.

        `ttl_s` bounds the start of the execution (at most 60), `limit_s` its end. Raises FogUnreachable when
        the activator is not live: the command was not sent then.
        """
        return self._station.send(self.number, None, command, ttl_s, limit_s)


class Drone:
    """One drone, as its ground station sees it."""

    def __init__(self, station: GroundStation, view: FogView, number: int) -> None:
        self._station = station
        self._view = view
        self.number = number

    @property
    def is_reachable(self) -> bool:
        drone = self._view.drones.get(self.number)
        return drone is not None and drone.reachable

    @property
    def is_controlled(self) -> bool:
        """Whether this station is in control of it."""
        return self._view.controls(self.number)

    @property
    def holder(self) -> str | None:
        """The name of the station in control, None when nobody is."""
        drone = self._view.drones.get(self.number)
        return drone.holder if drone is not None else None

    async def take_over(self, timeout_s: float = 10.0) -> None:
        """Take control of this drone, whoever has it; errors as `GroundStation.take_over`."""
        await self._station.take_over(self._view.number, (self.number,), timeout_s)

    @property
    def states(self) -> dict[str, KnownState]:
        """The newest state of each name."""
        drone = self._view.drones.get(self.number)
        now_ms = self._station.clock.now_ms()
        return {
            name: KnownState(known.message.state, self._view.age_ms(known, now_ms))
            for name, known in (drone.states if drone is not None else {}).items()
        }

    @property
    def readings(self) -> list[SensorReading]:
        """The newest reading of each kind of each sensor that this drone carries for."""
        latest = self._station.station.readings.latest
        return [latest[key] for key in sorted(latest) if key[0] == self.number]

    def outcomes(
        self, command: Command, *, ttl_s: float = DEFAULT_TTL_MS / 1000, limit_s: float | None = None
    ) -> AsyncIterator[Outcome]:
        """Send a command and yield its words up to the last one; errors as `Fog.broadcast`."""
        return self._station.send(self._view.number, self.number, command, ttl_s, limit_s)

    async def send(
        self, command: Command, *, ttl_s: float = DEFAULT_TTL_MS / 1000, limit_s: float | None = None
    ) -> Outcome:
        """Send a command and wait for its last word."""
        last = None
        async for outcome in self.outcomes(command, ttl_s=ttl_s, limit_s=limit_s):
            last = outcome
        assert last is not None
        return last
