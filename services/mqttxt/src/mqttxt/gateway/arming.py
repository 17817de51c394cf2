"""What waits for an arm, or an arm for it: takeoffs, missions, and the HOLD before arming (docs/gateway.md)."""

from __future__ import annotations

import asyncio
import contextlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

from ..protocol.commands import Arm, Command, Hold, Mavlink, Stream, Takeoff
from ..protocol.states import Armed, Severity, VelocityNed
from ..protocol.words import PASSED_OVER
from ..station.outcomes import Outcome
from ..station.views import Drone
from .answers import ACCEPTED
from .client_commands import ClientCommand
from .clients import Client
from .order import CommandOrder
from .texts import send_text
from .translation import NOT_NOW, Declined
from .work import Work, Worker

KEPT_MS = 10_000
"""How long a takeoff waits for its client to arm the drone."""
ARMED_MS = 3000
"""How long a completed arm outweighs a state that says disarmed: the word may arrive before the state."""
HEARD_MS = 10_000
"""How long a drone's silence may last for its state to count as the present one, which says disarmed."""


@dataclass(frozen=True)
class _KeptTakeoff:
    """A takeoff that arrived before its arm."""

    client: Client
    command: Takeoff
    until_ms: int


@dataclass
class Arming:
    """The newest arm of a drone, also after its end. `completed_ms`: when it was completed, None if it was not."""

    client: Client
    is_over: asyncio.Event
    completed_ms: int | None = None


class ArmingOrder(Worker):
    """The arms of all drones and what belongs before or behind them."""

    def __init__(self, work: Work, order: CommandOrder) -> None:
        super().__init__(work)
        self._order = order
        self._kept: dict[int, _KeptTakeoff] = {}
        self._armings: dict[int, Arming] = {}
        self._ground_holds: dict[int, ClientCommand] = {}
        self._rising = Counter[int]()
        self._risen_ms: dict[int, int] = {}

    def on_taken(self, drone: int) -> None:
        """Another station controls a drone now."""
        if drone in self._kept:
            self._drop_kept(drone)

    def on_permitted(self, entry: ClientCommand, drone: Drone, command: Command) -> None:
        """The client of a command may command its drone: its HOLD on the ground is awaited, another one's is not."""
        if not isinstance(command, Arm | Stream | Mavlink):
            self._ground_holds.pop(drone.number, None)
        if entry.is_quiet and isinstance(command, Hold) and self._is_on_ground(drone):
            entry.ground_hold = asyncio.get_running_loop().create_future()
            self._ground_holds[drone.number] = entry

    def tick(self, now_ms: int) -> None:
        """Give up the kept takeoffs that no arm has followed."""
        for drone in [drone for drone, kept in self._kept.items() if now_ms > kept.until_ms]:
            self._drop_kept(drone)

    def keep(self, entry: ClientCommand, command: Takeoff) -> None:
        """Accept a takeoff and keep it until the arm: QGroundControl arms only after that ACCEPTED."""
        self._kept[entry.drone] = _KeptTakeoff(entry.client, command, self._now_ms() + KEPT_MS)
        text = f"takeoff to {command.altitude_m:g} m waits {KEPT_MS // 1000} s for arm"
        send_text(entry.client.peer, entry.drone, Severity.NOTICE, text)
        entry.end(ACCEPTED, self._now_ms())

    def kept_for(self, client: Client, drone: int, command: Command) -> Takeoff | None:
        """The kept takeoff that follows an arm of the same client; any other command to fly gives it up."""
        kept = self._kept.get(drone)
        if kept is None or isinstance(command, Stream | Mavlink):
            return None
        if kept.client == client and isinstance(command, Arm):
            return self._kept.pop(drone).command
        self._drop_kept(drone)
        return None

    async def comes_before(self, entry: ClientCommand, drone: Drone) -> bool:
        """Whether a takeoff must wait for an arm that has not arrived yet. Raises Declined as `behind`."""
        if await self.behind(entry, drone):
            return False  # without an arm the drone denies it
        arming = self._armings.get(drone.number)
        armed_ms = None if arming is None else arming.completed_ms
        if armed_ms is not None and self._now_ms() - armed_ms <= ARMED_MS:
            return False
        return self._view(drone).get(Armed) == Armed(False)

    async def behind(self, entry: ClientCommand, drone: Drone) -> bool:
        """Wait for the end of the client's arm if a command comes right after it; returns whether it waited.

        Raises Declined if something else was commanded meanwhile.
        """
        arming = self._armings.get(drone.number)
        if arming is None or arming.client != entry.client or arming.is_over.is_set():
            return False
        await arming.is_over.wait()
        await self._control.heard(entry.client)
        if self._order.is_outdone(entry):
            raise self._order.given_up(entry)
        return True

    async def behind_ground_hold(self, entry: ClientCommand, drone: Drone) -> None:
        """Wait for the drone's word on a HOLD for which its client has ACCEPTED. This does not count in `ttl_s`.

        Raises Declined if the drone has not accepted it: armed, it might fly its mission.
        """
        hold = self._ground_holds.pop(drone.number, None)
        if hold is None or hold.ground_hold is None or hold.client != entry.client:
            return
        await asyncio.wait({hold.ground_hold})
        entry.asked_ms = self._now_ms()
        if not hold.ground_hold.result():
            raise Declined("not armed: the drone did not hold first", NOT_NOW)
        await self._control.heard(entry.client)
        if self._order.is_outdone(entry) or not entry.waits:
            raise self._order.given_up(entry)

    @contextlib.contextmanager
    def arming(self, client: Client, drone: int) -> Iterator[Arming]:
        """An arm from its sending to its end; set its `completed_ms`."""
        arming = self._armings[drone] = Arming(client, asyncio.Event())
        try:
            yield arming
        finally:
            arming.is_over.set()

    @contextlib.contextmanager
    def rising(self, drone: int, command: Command) -> Iterator[None]:
        """A drone is not known to be disarmed while one of its arms or takeoffs is open."""
        rises = isinstance(command, Arm | Takeoff)
        self._rising[drone] += rises
        try:
            yield
        finally:
            self._rising[drone] -= rises

    def on_last_word(self, drone: int, command: Command, last: Outcome) -> None:
        """A state older than an arm or takeoff that may have been carried out no longer counts."""
        if isinstance(command, Arm | Takeoff) and (last.is_of_activator or last.word not in PASSED_OVER):
            self._risen_ms[drone] = self._now_ms()

    def _is_on_ground(self, drone: Drone) -> bool:
        """Whether a drone is known to be disarmed: no arm or takeoff from here is open, or newer than that state."""
        view = self._view(drone)
        is_disarmed = view.get(Armed) == Armed(False) and view.is_recent(Armed, VelocityNed, within_ms=HEARD_MS)
        is_newer = view.measured_ms(Armed) > self._risen_ms.get(drone.number, -1)
        return drone.is_reachable and is_disarmed and is_newer and not self._rising[drone.number]

    def _drop_kept(self, drone: int) -> None:
        client = self._kept.pop(drone).client
        send_text(client.peer, drone, Severity.WARNING, "takeoff given up: no arm followed it")
