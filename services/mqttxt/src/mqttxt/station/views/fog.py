"""A fog as its ground station sees it."""

from __future__ import annotations

from ...protocol.commands import Command
from ...protocol.names import MAX_DRONE, check_number
from ...protocol.rankings import Ranked
from ..best import Place, best
from ..fog import FogView
from ..heard import SentCommand
from ..outcomes import Outcome, Outcomes, PsmiList
from ..process import StationRunner
from .commands import TTL_S
from .drone import TAKEOVER_S, Drone


class Fog:
    """One fog, as its ground station sees it: `GroundStation.connect` and `GroundStation.fog` return it."""

    def __init__(self, runner: StationRunner, view: FogView) -> None:
        self._runner = runner
        self._view = view

    @property
    def number(self) -> int:
        """The fog's number."""
        return self._view.number

    @property
    def fleet(self) -> str:
        """The name of its fleet, where the station is one of `Fleets`; empty where it is alone."""
        return self._runner.fleet

    @property
    def is_live(self) -> bool:
        """Whether its activator is up and its beacons keep arriving."""
        return self._view.is_live(self._runner.clock.now_ms())

    @property
    def drones(self) -> list[Drone]:
        """Every drone that is known to the fog, by number."""
        numbers = {*self._view.drones, *self._view.configured}
        return [Drone(self._runner, self._view, number) for number in sorted(numbers)]

    def drone(self, number: int) -> Drone:
        """A drone of this fog, whether or not the fog knows it yet.

        Parameters:
            number: the drone's number, 1 to 250.

        Raises:
            ConfigurationError: an invalid drone number.
        """
        return Drone(self._runner, self._view, check_number("drone", number, MAX_DRONE))

    @property
    def ranking(self) -> tuple[Ranked, ...]:
        """QoDS: the available drones, best first, as the activator last ranked them."""
        return self._view.ranking

    async def take_over(self, drones: tuple[int, ...] | None = None, timeout_s: float = TAKEOVER_S) -> None:
        """Take control of drones of the fog from any holder.

        A station with `control=False` or drones' numbers keeps those alone that it wants or has claimed.

        Parameters:
            drones: the drones' numbers; None: all of the fog.
            timeout_s: how long to wait for the confirmation, in seconds.

        Raises:
            FogUnreachable: the activator is not live, or has not confirmed in time.
            ConfigurationError: an invalid drone number, or a timeout that is not above 0.
            StationEnded, BrokerRefused: the station has ended.
        """
        numbers = None if drones is None else tuple(check_number("drone", number, MAX_DRONE) for number in drones)
        await self._runner.take_over(self.number, numbers, timeout_s)

    def best(
        self, command: Command, *, ttl_s: float = TTL_S, limit_s: float | None = None
    ) -> SentCommand[Outcome, Outcome | PsmiList]:
        """Send a command to the drone of this fog that arrives first (PSMI); as `GroundStation.best` with this fog.

        Parameters:
            command: a `Goto`.
            ttl_s: seconds within which the execution must start, at most 60.
            limit_s: seconds within which the execution must end; None: the command's own limit.

        Raises:
            FogUnreachable: the activator is not live; nothing was sent.
            ConfigurationError: another command, or an invalid time; nothing was sent.
            PayloadError: a field of the command that cannot be encoded; nothing was sent.
            StationEnded, BrokerRefused: the station has ended; nothing was sent.
        """
        return best([self._place], command, ttl_s, limit_s)

    def broadcast(
        self, command: Command, *, ttl_s: float = TTL_S, limit_s: float | None = None
    ) -> SentCommand[Outcomes, Outcome]:
        """Send a command to every drone of the fog with this call; `await` gives each drone's last word.

        Parameters:
            command: `Arm`, `Disarm`, `Takeoff`, `Land`, `Hold`, `Return`, `Stream` or `Pause`.
            ttl_s: seconds within which the execution must start, at most 60.
            limit_s: seconds within which the execution must end; None: the command's own limit.

        Raises:
            FogUnreachable: the activator is not live; nothing was sent.
            ConfigurationError: another command, or an invalid time; nothing was sent.
            PayloadError: a field of the command that cannot be encoded; nothing was sent.
            StationEnded, BrokerRefused: the station has ended; nothing was sent.
        """
        return self._runner.send(self._view, None, command, ttl_s, limit_s, Outcomes.of)

    @property
    def _place(self) -> Place:
        return self._runner, self.number
