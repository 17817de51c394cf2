"""A drone as its ground station sees it."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar, cast

from ...errors import ConfigurationError, PayloadError, TransferFailed
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

TAKEOVER_S = 10.0
UPLOAD_TTL_S = 30.0
"""How soon an upload has to begin: the drone reads what its autopilot has before."""
_STAGINGS = 3
"""How often a plan is staged that the drone does not have any more once it is committed: it was started anew."""

AState = TypeVar("AState", bound=State)
AVitalState = TypeVar("AVitalState", bound=VitalState)
AnObject = TypeVar("AnObject")


class NotInControl(ConfigurationError):
    """This station does not control the drone; `holder` is the name of the one that does, None where nobody does."""

    def __init__(self, drone: str, holder: str | None) -> None:
        super().__init__(f"drone {drone}: expected this station in control, not {holder or 'nobody'}")
        self.holder = holder


@dataclass(frozen=True)
class KnownState(Generic[AState]):
    """A state as it was last heard.

    Parameters:
        state: the value.
        age_ms: an upper bound of its age now, in milliseconds; None where the fog's clock is not known yet.
    """

    state: AState
    age_ms: int | None


class Drone(DroneCommands):
    """One drone, as its ground station sees it: `Fog.drone` and `Fog.drones` return it.

    Each of its commands is sent by the call. `await` gives the drone's one last word; `async for` follows every word up
    to that one (`SentCommand`). They all take, beside what the command has of its own:

    Parameters:
        ttl_s: seconds within which the execution must start, at most 60. A command that comes later is not executed.
        limit_s: seconds within which the execution must end; None: the command's own limit.

    Raises:
        FogUnreachable: the fog's activator is not live; nothing was sent.
        ConfigurationError: a time that cannot be; nothing was sent.
        PayloadError: a field of the command that cannot be carried; nothing was sent.
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

    def __str__(self) -> str:
        """As it is named, `1`, and among several fleets `acme/1`."""
        return in_fleet(self.fleet, self.number)

    @property
    def is_reachable(self) -> bool:
        """Whether its fog is live and says that the drone is there."""
        return self._view.reachable

    @property
    def is_controlled(self) -> bool:
        """Whether this station is in control of it; not from `release` on, until its fog has answered a new `claim`."""
        return self._fog.controls(self.number)

    @property
    def holder(self) -> str | None:
        """The name of the station in control, None when nobody is."""
        return self._view.holder

    def claim(self) -> None:
        """Want control of this drone while nobody has it, from now on; `is_controlled` tells when it came.

        For a station with `control=False`, which wants no others.

        Raises:
            ConfigurationError: the station wants all drones as it is.
            StationEnded, BrokerRefused: the station has ended.
        """
        self._runner.claim(self._fog.number, self.number, wanted=True)

    def release(self) -> None:
        """Give up control of this drone and do not want it any more; errors as `claim`."""
        self._runner.claim(self._fog.number, self.number, wanted=False)

    async def take_over(self, timeout_s: float = TAKEOVER_S) -> None:
        """Take control of this drone, whoever has it; `timeout_s` and errors as `Fog.take_over`.

        A station with `control=False` keeps it only where it has claimed the drone.
        """
        await self._runner.take_over(self._fog.number, (self.number,), timeout_s)

    @property
    def location(self) -> KnownState[Location] | None:
        """Where it is, with the age of that; None before it was heard."""
        return self.state(Location)

    def state(self, kind: type[AVitalState]) -> KnownState[AVitalState] | None:
        """The newest state of a kind with its age; None before one was heard.

        Parameters:
            kind: one of the classes in `STATES`, as `Battery`. A MAVLink message is in `states`, by its name.
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
        """The newest reading of each kind of each sensor that this drone carries for."""
        latest = self._runner.station.readings.latest
        return [self._runner.of_fleet(latest[key]) for key in sorted(latest) if key[0] == self.number]

    def send(
        self, command: Command, *, ttl_s: float = TTL_S, limit_s: float | None = None
    ) -> SentCommand[Outcome, Outcome]:
        """Send any command; `ttl_s`, `limit_s` and the errors are those of `Drone`.

        Parameters:
            command: what to do.
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
        """Replace the drone's plan; returns the last word, completed when what was read back is that plan.

        The plan is carried first, which has no deadline and goes on after a broken connection; then it is committed.
        A drone that this station does not control is not sent the plan, and the word says who controls it.

        Parameters:
            plan: what to upload.
            timeout_s: how long to carry it at most, in seconds; None: as long as it takes.
            progress: called with the bytes of the plan, compressed, that the drone has, and with those of the whole.

        Raises:
            TransferFailed: the plan was not carried in time, or the drone does not keep it; the old plan is there.
            FogUnreachable: the activator is not live; nothing was committed.
            ConfigurationError: a time that cannot be, or a right that is missing; nothing was committed.
            PayloadError: a plan that cannot be carried; nothing was sent.
            StationEnded, BrokerRefused: the station has ended.
        """
        packed = plan.content.packed()
        staging = Staging(self._fog, self.number, PLAN, packed)
        command = UploadPlan(staging.hash)
        self._runner.check_right(command, self.number)
        for _ in range(_STAGINGS):
            if self.is_controlled:
                staging = Staging(self._fog, self.number, PLAN, packed)
                await self._runner.transfer(staging, timeout_s, _telling(staging, len(packed), progress))
            last = await self.send(command, ttl_s=ttl_s)
            if last.reason != "not_staged" or not self.is_controlled:
                break
        return last

    async def download(self, *, timeout_s: float = 120.0) -> Plan:
        """The plan that the autopilot has now, all three lists; `Plan.save` makes a file of it.

        Parameters:
            timeout_s: how long to wait for all of it, in seconds.

        Raises:
            TransferFailed: the drone has not given it in time, or cannot read it.
            ConfigurationError: this station does not control the drone, or the timeout is not above 0.
            StationEnded, BrokerRefused: the station has ended.
        """
        content = await self._fetched(PLAN, PlanObject.unpacked, timeout_s)
        known = self.state(Home)
        home = known.state if known is not None else None
        return Plan(
            content, (home.latitude_deg, home.longitude_deg, home.altitude_amsl_m) if home is not None else None
        )

    async def parameters(self, known: Parameters | None = None, *, timeout_s: float = 300.0) -> Parameters:
        """The parameters that the autopilot has now.

        Parameters:
            known: parameters of this drone from before, so that only what has changed since is carried.
            timeout_s: how long to wait for all of them, in seconds.

        Raises:
            TransferFailed: the drone has not given them in time, or cannot read them.
            ConfigurationError: this station does not control the drone, or the timeout is not above 0.
            StationEnded, BrokerRefused: the station has ended.
        """
        base = known.content if known is not None else None

        def unpack(data: bytes) -> Parameters:
            if known is not None and not data:
                return known
            return Parameters(ParameterSet.unpacked(data, base))

        return await self._fetched(PARAMETERS, unpack, timeout_s, base.hash if base is not None else None)

    async def logs(self, *, timeout_s: float = 60.0) -> tuple[FlightLog, ...]:
        """The flight logs that the autopilot has now, in the order of their numbers. The drone has to be disarmed.

        Parameters:
            timeout_s: how long to wait for the list, in seconds.

        Raises:
            TransferFailed: the drone has not given it in time, is armed, or its autopilot does not answer.
            ConfigurationError: this station does not control the drone, or the timeout is not above 0.
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
        """Write one of the logs that `logs` has given into a file, in the place of one that is there.

        The drone reads the log from its autopilot first, for which it has to be disarmed, and then hands it on, in
        flight too. What breaks off goes on where it was: what has come is beside `path`, in a hidden file, until the
        log is whole and its hash is right.

        Parameters:
            log: which.
            path: the file.
            most_bytes_s: how many bytes to carry in a second at most, 1024 or more.
            timeout_s: how long to take at most, in seconds; None: as long as it takes.
            progress: called with how far it is, from time to time.

        Raises:
            TransferFailed: the drone has not given it in time, is armed, does not have it any more, or cannot keep it.
            ConfigurationError: this station does not control the drone, or the file cannot be written; a number that
                cannot be.
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
        """The newest object of a kind; `known` is the hash of one from before, where that may be all that comes."""
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
    """What passes on how far a plan has come."""

    async def tell() -> None:
        staging.told = staging.done
        if progress is not None:
            progress(staging.done, size)

    return tell
