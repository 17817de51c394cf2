"""The Fleet interface: what a mission can ask of its drones, whatever protocol carries it."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol


@dataclass(frozen=True)
class Result:
    """How a command ended for one drone: the last word and why."""

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
    """Where a drone is sent: WGS84 degrees, and metres above its home."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float


@dataclass(frozen=True)
class Survey:
    """Points that are flown to one after the other, behind a takeoff to the first one's altitude; then the return.

    So it is a mission of two items more than it has points.
    """

    points: tuple[Point, ...]


@dataclass(frozen=True)
class Status:
    """What is known of a drone: None where nothing was heard yet. Altitude is in metres above home."""

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
    """A value that a sensor measured and a drone carried, as mqttxt.SensorReading has it."""

    drone: int
    sensor: int
    boot: int
    seq: int
    kind: str
    value: float
    unit: str
    time_ms: int


class Fleet(Protocol):
    """Six drones or any other number. Every command returns one result for each drone that it goes to, mostly all."""

    @property
    def drones(self) -> tuple[int, ...]: ...

    async def connect(self, limit_s: float) -> None:
        """Wait until every drone is reachable and has published its states; raises MissionError."""

    async def close(self) -> None: ...

    def within(self, limit_s: float) -> float:
        """Commands from now on may take so long; returns in how many seconds each has its last word, or has none."""

    async def arm(self) -> list[Result]: ...

    async def takeoff(self, altitude_m: float) -> list[Result]: ...

    async def land(self) -> list[Result]: ...

    async def goto(self, points: Mapping[int, Point]) -> list[Result]:
        """Each drone of `points` flies to its own; completed on arrival."""

    async def goto_best(self, point: Point) -> Result:
        """The drone that arrives first flies there: completed on arrival, with the drone that it was.

        MQTT-XT's activators choose (PSMI). Raises MissionError where the protocol has no such choice, or nobody can.
        """

    async def return_home(self) -> list[Result]:
        """Back to the takeoff point and down; completed when landed and disarmed."""

    async def upload(self, surveys: Mapping[int, Survey]) -> list[Result]:
        """Replace the mission of each drone of `surveys`; completed as the protocol says that the drone has it."""

    async def fly_survey(self) -> list[Result]:
        """Fly the missions that were uploaded; completed when landed and disarmed."""

    @property
    def readings(self) -> Sequence[Reading]:
        """Every sensor's reading that has arrived, each once."""

    def status(self, drone: int) -> Status: ...

    async def changed(self) -> None:
        """Return when something was heard since the last call."""


class Told(NamedTuple):
    """A state's value, and how old it was at most when it came, in ms; None where it is unknown."""

    value: dict[str, Any]
    age_ms: int | None


class MessageFleet(Fleet, Protocol):
    """One drone, that is asked and listened to message by message."""

    tells_faster: bool
    """Whether states come at the vehicle's own rates, which are not those that `request_state` asks for."""

    async def call(self, call: int, name: str) -> Result:
        """One API call of a command by its name, returning when the autopilot has acknowledged it or the call failed.

        `call` is its number in the events.
        """

    async def settle(self) -> bool:
        """Wait until nothing goes on of the last call; whether that came about within its limit."""

    def follows(self, armed: bool) -> bool:
        """Whether the ground station knows that the drone is in hold, and armed or not."""

    async def stop_fixed_rates(self) -> None:
        """End the states that the arm has at a fixed rate; raises MissionError."""

    async def request_state(self, name: str) -> asyncio.Queue[Told]:
        """Ask for a state at 1 Hz; returns where its values arrive. Raises MissionError."""

    async def stop_state(self, name: str) -> None:
        """End what `request_state` began."""


class MissionError(Exception):
    """Why a mission failed; the text is the attempt's reason."""
