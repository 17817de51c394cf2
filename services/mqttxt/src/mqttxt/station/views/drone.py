"""A drone as its ground station sees it."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import TypeVar, cast

from ...errors import ConfigurationError, NotInControl, PayloadError, TransferFailed
from ...protocol.commands import Command, UploadPlan
from ...protocol.logs import LOGS, FlightLog, unpack_logs
from ...protocol.names import in_fleet
from ...protocol.parameters import PARAMETERS, ParameterSet
from ...protocol.plans import PLAN, PlanObject
from ...protocol.states import Home, Location, State, VitalState
from ..drone_view import DroneView
from ..fog import FogView
from ..heard import SentCommand
from ..log_download import LEAST_BYTES_S, MOST_BYTES_S, LogDownload, LogProgress
from ..outcomes import Outcome, SensorReading, last_word
from ..parameters import Parameters
from ..plan import Plan
from ..process import StationRunner
from ..transfers import Fetching, Staging
from .commands import TTL_S, DroneCommands
from .known_state import KnownState

TAKEOVER_S = 10.0
UPLOAD_TTL_S = 30.0
"""Within how many seconds an upload must begin: the drone first reads the plan that its autopilot has."""
CARRIED_S = 300.0
"""For a program that uploads for people: how long a plan may be on its way to the drone until it is given up."""
_STAGINGS = 3
"""How often a plan is staged at most. A drone that restarts before the commit no longer has it."""

AVitalState = TypeVar("AVitalState", bound=VitalState)
AnObject = TypeVar("AnObject")


class Drone(DroneCommands):
    """One drone, as its ground station sees it: `Fog.drone` and `Fog.drones` return it.

    Calling a command's method sends it. `await` gives the drone's one last word; `async for` yields every word up to
    that one (`SentCommand`). Besides its own parameters, each of these methods has:

    Parameters:
        ttl_s: seconds within which the execution must start, at most 60. A command that arrives later is not executed.
        limit_s: seconds within which the execution must end; None: the command's own limit.

    Raises:
        FogUnreachable: the fog's activator is not live; nothing was sent.
        ConfigurationError: an invalid time; nothing was sent.
        PayloadError: a field of the command that cannot be encoded; nothing was sent.
        StationEnded, BrokerRefused: the station has ended; nothing was sent.
    """

    def __init__(self, runner: StationRunner, view: FogView, number: int) -> None:
        self._runner = runner
        self._fog = view
        self._number = number

    @property
    def number(self) -> int:
        """The drone's number: its MAVLink system id."""
        return self._number

    @property
    def fog(self) -> int:
        """The number of the drone's fog."""
        return self._fog.number

    @property
    def fleet(self) -> str:
        """The name of its fleet, where the station is one of `Fleets`; empty where it is alone."""
        return self._runner.fleet

    @property
    def prefix(self) -> str:
        """The prefix of its fleet's topics, as `acme/`; empty for none."""
        return self._runner.station.prefix

    def __str__(self) -> str:
        """Its name: `1`, or `acme/1` among several fleets."""
        return in_fleet(self.fleet, self.number)

    @property
    def is_reachable(self) -> bool:
        """Whether its fog is live and reports the drone as reachable."""
        return self._view.reachable and self._fog.is_live(self._runner.clock.now_ms())

    @property
    def is_controlled(self) -> bool:
        """Whether this station controls it; False from `release` until its fog has answered a new `claim`."""
        return self._fog.controls(self.number)

    @property
    def holder(self) -> str | None:
        """The name of the station in control, None if there is none."""
        return self._view.holder

    def claim(self) -> None:
        """Claim control of this drone whenever it is free, from now on; `is_controlled` shows when it was granted.

        For a station with `control=False` or drones' numbers, which wants control of no other drone that it has not
        claimed.

        Raises:
            ConfigurationError: the station wants all drones anyway.
            StationEnded, BrokerRefused: the station has ended.
        """
        self._runner.claim(self._fog.number, self.number, wanted=True)

    def release(self) -> None:
        """Give up control of this drone and claim it no longer; errors as `claim`."""
        self._runner.claim(self._fog.number, self.number, wanted=False)

    async def take_over(self, timeout_s: float = TAKEOVER_S) -> None:
        """Take control of this drone from any holder; `timeout_s` and errors as `Fog.take_over`.

        A station with `control=False` or drones' numbers keeps it only where it wants or has claimed the drone.
        """
        await self._runner.take_over(self._fog.number, (self.number,), timeout_s)

    @property
    def location(self) -> KnownState[Location] | None:
        """The drone's newest position with its age; None before the first."""
        return self.state(Location)

    def state(self, kind: type[AVitalState]) -> KnownState[AVitalState] | None:
        """The newest state of a kind with its age; None before the first.

        Parameters:
            kind: one of the classes in `STATES`, such as `Battery`. A MAVLink message is in `states`, by its name.
        """
        return cast("KnownState[AVitalState] | None", self.states.get(kind.name))

    @property
    def states(self) -> dict[str, KnownState[State]]:
        """The newest state of each name with its age, MAVLink messages as `mavlink/NAME`."""
        now_ms = self._runner.clock.now_ms()
        heard = self._view.states.items()
        return {name: KnownState(known.message.state, known.age_ms(now_ms)) for name, known in heard}

    @property
    def readings(self) -> list[SensorReading]:
        """The newest reading of each kind from each sensor whose readings this drone carries."""
        latest = self._runner.station.readings.latest
        return [self._runner.of_fleet(latest[key]) for key in sorted(latest) if key[0] == self.number]

    def send(
        self, command: Command, *, ttl_s: float = TTL_S, limit_s: float | None = None
    ) -> SentCommand[Outcome, Outcome]:
        """Send any command; `ttl_s`, `limit_s` and the errors are those of `Drone`.

        Parameters:
            command: the command.
        """
        return self._runner.send(self._fog, self._number, command, ttl_s, limit_s, last_word)

    async def upload(
        self,
        plan: Plan,
        *,
        timeout_s: float | None = None,
        ttl_s: float = UPLOAD_TTL_S,
        progress: Callable[[int, int], None] | None = None,
    ) -> Outcome:
        """Replace the drone's plan; returns the last word: completed when the plan that was read back is this one.

        The plan is first transferred, without a deadline and across broken connections, and then committed. A drone
        that this station does not control is not sent the plan, and the word names the station in control.

        Parameters:
            plan: the plan.
            timeout_s: how long the transfer may take, in seconds; None: no limit. A repeated transfer has it again.
            progress: called with how many bytes of the compressed plan the drone has, and with how many it has in all.

        Raises:
            TransferFailed: the plan was not transferred in time, or the drone refused it; the old plan remains.
            FogUnreachable: the activator is not live; nothing was committed.
            ConfigurationError: an invalid time, or a missing right; nothing was committed.
            PayloadError: a plan that cannot be encoded; nothing was sent.
            StationEnded, BrokerRefused: the station has ended.
        """
        packed = plan.content.packed()
        staging = Staging(self._fog, self.number, PLAN, packed)
        command = UploadPlan(staging.hash)
        self._runner.station.commands.check_right(self.number, command)
        for _ in range(_STAGINGS):
            if self.is_controlled:
                staging = Staging(self._fog, self.number, PLAN, packed)
                await self._runner.transfer(staging, timeout_s, _telling(staging, len(packed), progress))
            last = await self.send(command, ttl_s=ttl_s)
            if last.reason != "not_staged" or not self.is_controlled:
                break
        return last

    async def download(self, *, timeout_s: float = 120.0) -> Plan:
        """Fetch the plan that the autopilot has now, all three lists; `Plan.save` writes it to a file.

        Parameters:
            timeout_s: how long to wait for all of it, in seconds.

        Raises:
            TransferFailed: the drone did not deliver it in time, or cannot read it.
            NotInControl: this station does not control the drone.
            ConfigurationError: the timeout is not above 0.
            StationEnded, BrokerRefused: the station has ended.
        """
        content = await self._fetched(PLAN, PlanObject.unpacked, timeout_s)
        known = self.state(Home)
        home = known.state if known is not None else None
        return Plan(
            content, (home.latitude_deg, home.longitude_deg, home.altitude_amsl_m) if home is not None else None
        )

    async def parameters(self, known: Parameters | None = None, *, timeout_s: float = 300.0) -> Parameters:
        """Fetch the parameters that the autopilot has now.

        Parameters:
            known: earlier parameters of this drone; then only the changes since are transferred.
            timeout_s: how long to wait for all of them, in seconds.

        Raises:
            TransferFailed: the drone did not deliver them in time, or cannot read them.
            NotInControl: this station does not control the drone.
            ConfigurationError: the timeout is not above 0.
            StationEnded, BrokerRefused: the station has ended.
        """
        base = known.content if known is not None else None

        def unpack(data: bytes) -> Parameters:
            if known is not None and not data:
                return known
            return Parameters(ParameterSet.unpacked(data, base))

        return await self._fetched(PARAMETERS, unpack, timeout_s, base.hash if base is not None else None)

    async def logs(self, *, timeout_s: float = 60.0) -> tuple[FlightLog, ...]:
        """List the flight logs that the autopilot has now, in the order of their numbers. The drone must be disarmed.

        Parameters:
            timeout_s: how long to wait for the list, in seconds.

        Raises:
            TransferFailed: the drone did not deliver it in time, is armed, or its autopilot does not answer.
            NotInControl: this station does not control the drone.
            ConfigurationError: the timeout is not above 0.
            StationEnded, BrokerRefused: the station has ended.
        """
        return await self._fetched(LOGS, unpack_logs, timeout_s)

    async def download_log(
        self,
        log: FlightLog,
        path: Path | str,
        *,
        most_bytes_s: int = MOST_BYTES_S,
        timeout_s: float | None = None,
        progress: Callable[[LogProgress], None] | None = None,
    ) -> None:
        """Download one of the logs that `logs` listed into a file; an existing one is replaced, behind links.

        The drone first reads the log from its autopilot, for which it must be disarmed, and then sends it, in flight
        too. An interrupted download continues where it stopped: the received bytes are in a hidden file beside `path`
        until the log is whole and its hash is right.

        Parameters:
            log: the log, as `logs` returned it.
            path: the file.
            most_bytes_s: how many bytes to transfer per second at most, 1024 or more.
            timeout_s: how long the download may take, in seconds; None: no limit.
            progress: called from time to time with the progress.

        Raises:
            TransferFailed: the drone did not deliver it in time, is armed, no longer has it, or cannot store it.
            NotInControl: this station does not control the drone.
            ConfigurationError: the file cannot be written, or is no regular one; or a number is invalid.
            StationEnded, BrokerRefused: the station has ended.
        """
        self._check_control()
        if most_bytes_s < LEAST_BYTES_S:
            raise ConfigurationError(f"most_bytes_s {most_bytes_s}: expected {LEAST_BYTES_S} or more")
        download = LogDownload(self._runner, self._fog, self.number, log, Path(path), most_bytes_s, progress)
        await download.run(timeout_s)

    @property
    def _view(self) -> DroneView:
        return self._fog.drones.get(self.number) or DroneView(self.number)

    async def _fetched(
        self, kind: str, unpack: Callable[[bytes], AnObject], timeout_s: float, known: bytes | None = None
    ) -> AnObject:
        """Fetch the newest object of a kind, or its changes since the object whose hash is `known`."""
        self._check_control()
        fetching = Fetching(self._fog, self.number, kind, known)
        await self._runner.transfer(fetching, timeout_s)
        try:
            return unpack(fetching.data)
        except PayloadError as error:
            raise TransferFailed(f"{fetching}: {error}") from error

    def _check_control(self) -> None:
        if not self.is_controlled:
            raise NotInControl(str(self), self.holder)


def _telling(staging: Staging, size: int, progress: Callable[[int, int], None] | None) -> Callable[[], Awaitable[None]]:
    """A callback that reports the progress of a staging."""

    async def tell() -> None:
        staging.told = staging.done
        if progress is not None:
            progress(staging.done, size)

    return tell
