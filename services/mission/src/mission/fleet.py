"""The Fleet interface: a mission's commands to its drones, over any protocol."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol


@dataclass(frozen=True)
class CommandResult:
    """The outcome of a command for one drone: the last word and its reason."""

    drone: int
    word: str
    reason: str | None = None

    @property
    def completed(self) -> bool:
        return self.word == "completed"

    def __str__(self) -> str:
        return f"drone {self.drone}: {self.word}" + (f" ({self.reason})" if self.reason else "")


@dataclass(frozen=True)
class Point:
    """A drone's target: WGS84 degrees, and metres above its home."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float


@dataclass(frozen=True)
class Survey:
    """Points to fly to in order, after a takeoff to the first one's altitude and before the return.

    So its mission has two items more than it has points.
    """

    points: tuple[Point, ...]


@dataclass(frozen=True)
class Status:
    """The known state of a drone; unknown values are None. The altitude is in metres above home."""

    armed: bool | None = None
    mode: str | None = None
    altitude_m: float | None = None
    landed: str | None = None

    def __str__(self) -> str:
        if self.armed is None:
            return "silent"
        where = "on the ground" if self.landed == "on_ground" else f"{self.altitude_m or 0:.1f} m"
        return f"{'armed' if self.armed else 'disarmed'}, {where}" + (f", {self.mode}" if self.mode else "")


@dataclass(frozen=True)
class Reading:
    """A value that a sensor measured and a drone carried, with the fields of mqttxt.SensorReading."""

    drone: int
    sensor: int
    boot: int
    seq: int
    kind: str
    value: float
    unit: str
    time_ms: int


class Fleet(Protocol):
    """Six drones or any other number. Every command returns one result for each drone that gets it, mostly all."""

    @property
    def drones(self) -> tuple[int, ...]: ...

    async def connect(self, limit_s: float) -> None:
        """Wait until every drone is reachable and has published its states. Raises MissionError, also at `limit_s`."""

    async def close(self) -> None: ...

    def within(self, limit_s: float) -> float:
        """Limit commands from now on; returns the seconds after which no last word of theirs can arrive any more."""

    async def arm(self) -> list[CommandResult]: ...

    async def takeoff(self, altitude_m: float) -> list[CommandResult]: ...

    async def land(self) -> list[CommandResult]: ...

    async def goto(self, points: Mapping[int, Point]) -> list[CommandResult]:
        """Send each drone of `points` to its own point; completed on arrival."""

    async def goto_best(self, point: Point) -> CommandResult:
        """Send the drone that arrives first; completed on arrival. The result names the drone.

        MQTT-XT's activators choose it (PSMI). Raises MissionError if the protocol has no such choice, or no drone can.
        """

    async def return_home(self) -> list[CommandResult]:
        """Return to the takeoff point and land; completed when landed and disarmed."""

    async def upload(self, surveys: Mapping[int, Survey]) -> list[CommandResult]:
        """Replace the mission of each drone of `surveys`; completed when the protocol confirms the upload."""

    async def fly_survey(self) -> list[CommandResult]:
        """Fly the uploaded missions; completed when landed and disarmed."""

    @property
    def readings(self) -> Sequence[Reading]:
        """All sensors' readings that have arrived, each once."""

    def status(self, drone: int) -> Status: ...

    async def changed(self) -> None:
        """Return when a message arrived since the last call."""


class StateValue(NamedTuple):
    """A state's value, and its greatest possible age on arrival, ms; None if that is unknown."""

    value: dict[str, Any]
    age_ms: int | None


class MessageFleet(Fleet, Protocol):
    """One drone, whose messages are called and received one by one."""

    tells_faster: bool
    """Whether states arrive at the vehicle's own rates instead of those that `request_state` requests."""

    async def call(self, call: int, name: str) -> CommandResult:
        """Make one API call of a command; return when the autopilot has acknowledged it or the call has failed.

        `call` is its number in the events.
        """

    async def settle(self) -> bool:
        """Wait until the last call has ended completely; returns whether that was within the limit."""

    def follows(self, armed: bool) -> bool:
        """Whether the ground station knows the starting state: `armed` and, if the protocol needs it, hold."""

    async def stop_fixed_rates(self) -> None:
        """End the states that the arm publishes at a fixed rate. Raises MissionError."""

    async def request_state(self, name: str) -> asyncio.Queue[StateValue]:
        """Request a state at 1 Hz; returns the queue of its values. Raises MissionError."""

    async def stop_state(self, name: str) -> None:
        """End a request of `request_state`."""


class MissionError(Exception):
    """A mission failed; the text is the attempt's reason."""
