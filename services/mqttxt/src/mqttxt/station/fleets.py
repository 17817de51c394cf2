"""Several fleets in one cloud, followed and commanded as one (docs/protocol.md, R2.4)."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Callable, Iterable, Mapping
from types import TracebackType
from typing import Self

from ..core.settings import CONNECT_S
from ..errors import ConfigurationError, FogUnreachable, SigningDiffers, StationEnded
from ..protocol.commands import Command
from ..protocol.names import MAX_DRONE, NAME, parse_in_fleet
from .best import best
from .ground_station import GroundStation
from .heard import Events, EventStream, SentCommand
from .outcomes import Outcome, PsmiList
from .process import StationRunner, leave
from .views import TTL_S, Drone, Fog

_LEVEL = re.compile(f"(?![0-9]+$){NAME}")


class Fleets:
    """Several fleets as one: a ground station in each, distinguished by the prefix of its topics.

        async with Fleets(GroundStation(url, prefix="acme/"), GroundStation(url, prefix="north/")) as fleets:
            await fleets.connect({"acme": [1, 2], "north": [1]})
            outcome = await fleets.drone("acme/1").takeoff(10)

    A fleet's name is its prefix without the last `/`. Each station has its own connection, session and control, and
    where nodes have identities its own identity: nothing for a fog or a drone of one fleet is sent to another. Every
    event names its fleet. Inside `async with` all stations run. A station that ends because its broker refused it ends
    no other one; leaving raises its error.

    Parameters:
        stations: the stations, none of them entered, each with a prefix of its own of letters, digits, `_`, `.` and
            `-`, no level of which is a number.

    Raises:
        ConfigurationError: a prefix is missing, invalid or another station's; two stations have one session, or
            identities of one authority.
    """

    def __init__(self, *stations: GroundStation) -> None:
        self._stations: dict[str, GroundStation] = {}
        for station in stations:
            fleet = _fleet_of(station)
            if fleet.casefold() in map(str.casefold, self._stations):
                raise ConfigurationError(f"topic prefix '{fleet}/': a second one; expected another for each fleet")
            self._stations[fleet] = station
        if not self._stations:
            raise ConfigurationError("Fleets: expected a GroundStation for each fleet")
        _check_apart(self._stations)
        for fleet, station in self._stations.items():
            station._runner.fleet = fleet

    @property
    def name(self) -> str:
        """The stations' name; where they differ, all of them."""
        return ", ".join(dict.fromkeys(station.name for station in self._stations.values()))

    @property
    def stations(self) -> dict[str, GroundStation]:
        """Each fleet's station, by the fleet's name."""
        return dict(self._stations)

    async def __aenter__(self) -> Self:
        for station in self._stations.values():
            if station._runner.has_begun:
                raise StationEnded("a ground station is entered once: make another GroundStation")
        for station in self._stations.values():
            await station.__aenter__()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        runners = self._runners
        await leave(*runners)
        if error is None:
            for runner in runners:
                runner.result()

    async def connect(self, fogs: Mapping[str, Iterable[int]], timeout_s: float = CONNECT_S) -> list[Fog]:
        """Register at fogs of several fleets, and return them once each has confirmed, fleet by fleet.

        Parameters:
            fogs: the fogs' numbers, by the fleet's name.
            timeout_s: how long to wait, in seconds.

        Raises:
            FogUnreachable: a fog has not confirmed in time; the message says what is missing, as that of
                `GroundStation.connect`. The stations go on trying.
            ConfigurationError: an unknown fleet, an invalid fog number, a timeout that is not above 0, or a station not
                entered (`async with`).
            StationEnded, BrokerRefused: a station has ended.
        """
        asked = {fleet: (self._station(fleet), [*numbers]) for fleet, numbers in fogs.items()}
        found = await asyncio.gather(
            *(station.connect(numbers, timeout_s) for station, numbers in asked.values()), return_exceptions=True
        )
        missing = []
        for fleet, answer in zip(asked, found, strict=True):
            if isinstance(answer, FogUnreachable):
                missing.append(f"fleet {fleet}: {answer}")
            elif isinstance(answer, BaseException):
                raise answer
        if missing:
            differs = any(isinstance(answer, SigningDiffers) for answer in found)
            raise (SigningDiffers if differs else FogUnreachable)("; ".join(missing))
        return [fog for answer in found if not isinstance(answer, BaseException) for fog in answer]

    @property
    def fogs(self) -> list[Fog]:
        """Every fog that `connect` was called with, fleet by fleet."""
        return [fog for station in self._stations.values() for fog in station.fogs]

    @property
    def drones(self) -> list[Drone]:
        """Every drone that is known to one of these fogs, fleet by fleet."""
        return [drone for fog in self.fogs for drone in fog.drones]

    def fog(self, name: str) -> Fog:
        """A fog that `connect` was called with.

        Parameters:
            name: its fleet and its number, as `acme/1`.

        Raises:
            FogUnreachable: `connect` was not called with it.
            ConfigurationError: an invalid name, or an unknown fleet.
        """
        fleet, number = parse_in_fleet("fog", name)
        return self._station(fleet).fog(number)

    def drone(self, name: str) -> Drone:
        """A drone that is known to a fog; where several know it, as seen by the one that reports it as reachable.

        Parameters:
            name: its fleet and its number, as `acme/1`.

        Raises:
            FogUnreachable: no fog that `connect` was called with knows it, or several report it as reachable.
            ConfigurationError: an invalid name, or an unknown fleet.
        """
        fleet, number = parse_in_fleet("drone", name, MAX_DRONE)
        return self._station(fleet).drone(number)

    def events(self) -> EventStream:
        """Every event of all fleets from this call on, as `GroundStation.events`; it ends with the last station.

        Raises nothing; iterating raises BrokerRefused where the broker ended a station, once all have ended.
        """
        record = _Joined(len(self._stations))
        for runner in self._runners:
            runner.listen(record)
        return EventStream(record)

    async def wait_until(self, condition: Callable[[], bool], timeout_s: float) -> None:
        """Wait until a condition holds. It is evaluated at least twenty times per second.

        Parameters:
            condition: called without arguments; returns whether it holds.
            timeout_s: how long to wait, in seconds.

        Raises:
            TimeoutError: the condition does not hold in time.
            ConfigurationError: the timeout is not above 0.
            StationEnded, BrokerRefused: a station ends before.
        """
        first, *others = self._runners

        def holds() -> bool:
            is_so = condition()
            if not is_so:
                for runner in others:
                    runner.check()
            return is_so

        await first.wait_until(holds, timeout_s)

    def best(
        self, command: Command, fogs: Iterable[Fog] | None = None, *, ttl_s: float = TTL_S, limit_s: float | None = None
    ) -> SentCommand[Outcome, Outcome | PsmiList]:
        """Send a command to the drone that arrives first (PSMI), in any fleet; as `GroundStation.best`.

        Parameters:
            command: a `Goto`.
            fogs: the fogs among which to choose; None: all that `connect` was called with.
            ttl_s: seconds within which the execution must start, at most 60; among several fogs from their offers on,
                for which `best` waits as long at the most.
            limit_s: seconds within which the execution must end; None: the command's own limit.

        Raises:
            FogUnreachable: none of the activators is live; nothing was sent. Awaiting raises it as that of
                `GroundStation.best` does.
            ConfigurationError: a command other than `Goto`, or an invalid time; nothing was sent.
            PayloadError: a field of the command that cannot be encoded; nothing was sent.
            StationEnded, BrokerRefused: the stations have ended; nothing was sent.
        """
        return best([fog._place for fog in (self.fogs if fogs is None else fogs)], command, ttl_s, limit_s)

    async def reload(self) -> None:
        """`GroundStation.reload` of each station. Raises nothing."""
        await asyncio.gather(*(station.reload() for station in self._stations.values()))

    @property
    def _runners(self) -> list[StationRunner]:
        return [station._runner for station in self._stations.values()]

    def _station(self, fleet: str) -> GroundStation:
        if fleet not in self._stations:
            raise ConfigurationError(f"fleet {fleet!r}: expected one of {', '.join(self._stations)}")
        return self._stations[fleet]


class _Joined(Events):
    """The events of several stations; it ends with the last station, with the first error."""

    def __init__(self, stations: int) -> None:
        super().__init__()
        self._left = stations
        self._first_error: BaseException | None = None

    def end(self, error: BaseException | None = None) -> None:
        self._left -= 1
        self._first_error = self._first_error or error
        if self._left == 0:
            super().end(self._first_error)


def _fleet_of(station: GroundStation) -> str:
    """A station's fleet by its prefix; raises ConfigurationError for a prefix that is not fit among several fleets."""
    prefix = station.prefix
    if not all(_LEVEL.fullmatch(level) for level in prefix.removesuffix("/").split("/")):
        raise ConfigurationError(
            f"topic prefix {prefix!r}: expected one for each of several fleets, as 'acme/', of letters, digits, '_', "
            "'.' and '-', and no level that is a number"
        )
    return prefix.removesuffix("/")


def _check_apart(stations: Mapping[str, GroundStation]) -> None:
    """Raises ConfigurationError where two stations have the same session or authority and could be confused."""
    sessions: set[int] = set()
    authorities: dict[bytes, str] = {}
    for fleet, station in stations.items():
        runner = station._runner
        if station.session in sessions:
            raise ConfigurationError(f"fleet {fleet}: the session of another one; expected a clock of its own")
        sessions.add(station.session)
        if runner.identity is not None:
            key = runner.identity.fleet.key_hash
            if key in authorities:
                raise ConfigurationError(
                    f"identity {runner.identity.folder}: of the same authority as that of fleet {authorities[key]}; "
                    f"expected one that fleet {fleet}'s own authority has issued"
                )
            authorities[key] = fleet
