"""A made-up fleet behind the live page: what a station would show of it, without a broker."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from mqttxt import (
    Armed,
    Battery,
    Command,
    CommandId,
    ConfigurationError,
    Event,
    FlightMode,
    FlightModeName,
    FogUnreachable,
    Groundspeed,
    KnownState,
    Location,
    Outcome,
    Plan,
    Ranked,
    SensorReading,
    State,
    Word,
)
from mqttxt.page.links import LinkFigures


def outcome(word: Word, drone: int | None = 1, seq: int = 1, **more: Any) -> Outcome:
    return Outcome(CommandId(7, seq), 1, drone, "takeoff", word, **more)


class FakeLinks:
    """One link, which records the changes requested of it."""

    title = "MQTT-XT"

    def __init__(self) -> None:
        self.told: list[tuple[str, dict[str, str], bool] | str] = []
        self.error: ConfigurationError | None = None
        self.delay_ms = 25.0

    def look(self) -> list[LinkFigures]:
        up = LinkFigures("air:uav1:up", 12.34, 5678.0, 20_000_000, self.delay_ms, 0.01, False, False)
        return [up, replace(up, name="air:uav1:down", rate_bps=None, is_closed=True, is_changed=True)]

    def change(self, name: str, figures: Mapping[str, str], closed: bool) -> None:
        self.told.append((name, dict(figures), closed))
        if self.error is not None:
            raise self.error
        self.delay_ms = float(figures.get("delay", "25ms").removesuffix("ms"))

    def put_back(self, name: str) -> None:
        self.told.append(name)


@dataclass
class FakeSent:
    """A command that was sent; a test puts its outcomes into `words`."""

    command: Command
    ttl_s: float
    words: asyncio.Queue[Outcome | Exception] = field(default_factory=asyncio.Queue)

    async def __aiter__(self) -> AsyncIterator[Outcome]:
        while True:
            said = await self.words.get()
            if isinstance(said, Exception):
                raise said
            yield said
            if said.is_last:
                return


class FakeDrone:
    def __init__(self, number: int, station: FakeStation) -> None:
        self.number = number
        self.is_reachable = True
        self.is_controlled = True
        self.holder: str | None = "page"
        self.readings: list[SensorReading] = []
        self.uploaded: list[Plan] = []
        self.upload_ttl_s = 0.0
        self.upload_timeout_s: float | None = None
        self.upload_word: Outcome | Exception = outcome(Word.COMPLETED)
        self.states: dict[str, KnownState[State]] = {}
        self._station = station
        shift = number / 5000
        self.set(
            *(Armed(False), FlightMode(FlightModeName.HOLD), Location(47.0 + shift, 8.0 + shift, 498.0, 10.0)),
            *(Groundspeed(1.0), Battery(90)),
        )

    def set(self, *states: State, age_ms: int | None = 100) -> None:
        self.states |= {state.name: KnownState(state, age_ms) for state in states}

    def send(self, command: Command, *, ttl_s: float) -> FakeSent:
        return self._station.sent_to(self.number, command, ttl_s)

    async def upload(
        self, plan: Plan, *, ttl_s: float, progress: Callable[[int, int], None], timeout_s: float | None = None
    ) -> Outcome:
        self.uploaded.append(plan)
        self.upload_ttl_s, self.upload_timeout_s = ttl_s, timeout_s
        for done in (0, 1024, 1500):
            progress(done, 1500)
            await asyncio.sleep(0)
        if isinstance(self.upload_word, Exception):
            raise self.upload_word
        return self.upload_word


class FakeFog:
    number = 1
    is_live = True
    ranking: tuple[Ranked, ...] = ()

    def __init__(self, station: FakeStation, drones: int, fleet: str = "") -> None:
        self.fleet = fleet
        self._station = station
        self.drones = [FakeDrone(number, station) for number in range(1, drones + 1)]

    def drone(self, number: int) -> FakeDrone:
        return self.drones[number - 1]

    def broadcast(self, command: Command, *, ttl_s: float) -> FakeSent:
        return self._station.sent_to(None, command, ttl_s)

    async def take_over(self, *, drones: tuple[int, ...]) -> None:
        self._station.taken.append((self.number, drones))
        for number in drones:
            self.drone(number).is_controlled, self.drone(number).holder = True, "page"


class FakeStation:
    """`sent` has each command with the drone's number, None for a whole fog."""

    name = "page"
    prefix = ""
    broker = "cloud.example:8883"

    def __init__(self, drones: int = 2, fleet: str = "") -> None:
        self.heard: asyncio.Queue[Event | Exception | None] = asyncio.Queue()
        self.the_fog = FakeFog(self, drones, fleet)
        self.sent: list[tuple[int | None, FakeSent]] = []
        self.taken: list[tuple[int, tuple[int, ...]]] = []

    def best(self, command: Command, fogs: list[FakeFog], *, ttl_s: float) -> FakeSent:
        return self.sent_to(None, command, ttl_s)

    def sent_to(self, drone: int | None, command: Command, ttl_s: float) -> FakeSent:
        if not self.the_fog.is_live:
            raise FogUnreachable("fog 1: not live")
        self.sent.append((drone, FakeSent(command, ttl_s)))
        return self.sent[-1][1]

    async def events(self) -> AsyncIterator[Event]:
        while (event := await self.heard.get()) is not None:
            if isinstance(event, Exception):
                raise event
            yield event
