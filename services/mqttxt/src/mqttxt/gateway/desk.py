"""Clients' commands, from their first COMMAND_ACK to their last word (docs/gateway.md)."""

from __future__ import annotations

import asyncio
import contextlib
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace

from ..core.ledger import OVERRIDING
from ..protocol.codec import encode
from ..protocol.commands import (
    Arm,
    Command,
    Disarm,
    Hold,
    Mavlink,
    Resume,
    SetCurrentItem,
    StartMission,
    Stream,
    Takeoff,
)
from ..protocol.states import Armed, Severity, VelocityNed
from ..protocol.words import PASSED_OVER
from ..station.heard import SentCommand
from ..station.outcomes import Outcome
from ..station.views import Drone
from .answers import ACCEPTED
from .clients import Client
from .control import ClientControl
from .endpoints import Peer
from .entries import (
    CANCELLED,
    FIRST_PROGRESS_MS,
    GROUND_HOLD_MS,
    MODE_PATIENCE_MS,
    NUMBERED_REPEAT_MS,
    PROGRESS_MS,
    Arming,
    Entry,
    KeptTakeoff,
    acknowledge,
    declining,
    is_quiet,
)
from .telemetry import View
from .texts import send_text
from .translation import NOT_NOW, REQUEST_OPERATOR_CONTROL, Declined, Request, command_of, name_of
from .uploads import Uploads

UNANSWERED_MS = 10_000
"""How long to wait for a command's first word after the last moment at which the command may start."""
KEPT_MS = 10_000
"""How long a takeoff waits for its client to arm the drone."""
ARMED_MS = 3000
"""How long a completed arm outweighs a state that says disarmed: the word may arrive before the state."""
HEARD_MS = 10_000
"""How long a drone's silence may last for its state to count as the present one, which says disarmed."""
MOST_UNDER_WAY = 32
"""Commands for one drone without a last word; those that stop it are not limited."""
MOST_OF_STRANGERS = 64
"""Commands that are remembered of all clients of one socket that send no HEARTBEAT."""
_STOPPING = (*OVERRIDING, Disarm)
_BY_THE_PLAN = (Arm, StartMission, Resume, SetCurrentItem)
"""Commands that rely on the plan that their client has uploaded."""
_BESIDE = (*_BY_THE_PLAN, Takeoff, Stream, Mavlink)
"""Commands behind which an older one is still sent; behind any other command it is not."""


class Desk:
    """The commands of all clients, each followed by a task of `group`.

    `view` returns what is known of a drone now, `now_ms` the time of the gateway's clock.
    """

    def __init__(
        self,
        control: ClientControl,
        uploads: Uploads,
        view: Callable[[Drone], View],
        now_ms: Callable[[], int],
        group: asyncio.TaskGroup,
        ttl_s: float,
    ) -> None:
        self._control = control
        self._uploads = uploads
        self._view = view
        self._now_ms = now_ms
        self._group = group
        self._ttl_s = ttl_s
        self._entries: dict[tuple[Client, int], dict[Request, Entry]] = {}
        """The open commands and those of the last ten seconds, per client and drone in their order."""
        self._strangers = Counter[Peer]()
        self._asked = 0
        self._newest: dict[int, int] = {}
        """Per drone the place of the newest command of a client that may command it."""
        self._earliest: dict[int, int] = {}
        """Per drone the first place that may still be sent: older commands come too late."""
        self._kept: dict[int, KeptTakeoff] = {}
        self._armings: dict[int, Arming] = {}
        self._ground_holds: dict[int, Entry] = {}
        self._turns: dict[int, asyncio.Lock] = {}
        self._under_way = Counter[int]()
        self._rising = Counter[int]()
        self._risen_ms: dict[int, int] = {}

    def on_request(
        self,
        client: Client,
        drone: Drone,
        request: Request,
        confirmation: int,
        takeoff_m: float,
        *,
        is_late: bool = False,
    ) -> None:
        """Carry out a client's command, or acknowledge a repeated one again. A late one is not carried out."""
        view = self._view(drone)
        own = self._entries.get((client, drone.number), {})
        known = own.get(request)
        if known is not None:
            newest = next(one for one in reversed(own.values()) if one is known or not one.is_declined)
            if known.is_repeated(confirmation, newest is known, view.now_ms):
                known.repeat()
                return
        if not self._control.knows(client):
            if self._strangers[client.peer] >= MOST_OF_STRANGERS:
                acknowledge(client, drone.number, request, NOT_NOW)
                return
            self._strangers[client.peer] += 1
        self._asked += 1
        due_ms = view.now_ms + FIRST_PROGRESS_MS
        entry = Entry(client, drone.number, request, view.now_ms, due_ms, self._asked, confirmation)
        self._remember(entry, own)
        try:
            if is_late:
                text = f"{name_of(request.mav_cmd)} not sent: it waited while the gateway stood still"
                raise Declined(text, NOT_NOW)
            if request.mav_cmd == REQUEST_OPERATOR_CONTROL:
                self._group.create_task(self._change_control(entry, drone))
                return
            meant = replace(view, named=self._uploads.mission(client, drone.number))
            command = command_of(request, meant, takeoff_m)
            entry.is_quiet = is_quiet(request, command)
            self._group.create_task(self._carry_out(entry, drone, command))
        except Declined as declined:
            entry.decline(declined, self._now_ms())

    def on_taken(self, drone: int) -> None:
        """Another station controls a drone now: revoke what still waits, so that it does not take the drone back."""
        self._newest[drone] = self._earliest[drone] = self._asked + 1
        if drone in self._kept:
            self._drop_kept(drone)

    def tick(self, now_ms: int) -> None:
        """Send IN_PROGRESS for waiting commands; end unanswered ones, modes that waited too long, and kept takeoffs."""
        self._drop_old(now_ms)
        for entry in (entry for own in self._entries.values() for entry in own.values()):
            is_silent = entry.waits and not entry.is_answered and not entry.is_kept
            if is_silent and now_ms > entry.asked_ms + self._ttl_s * 1000 + UNANSWERED_MS:
                entry.end(None, now_ms)
                text = f"{name_of(entry.request.mav_cmd)}: no answer, it may have been done"
                send_text(entry.client.peer, entry.drone, Severity.CRITICAL, text)
            elif entry.waits and entry.is_quiet and entry.is_kept and now_ms >= entry.asked_ms + MODE_PATIENCE_MS:
                text = (
                    f"{name_of(entry.request.mav_cmd)}: the drone does not have the plan yet, not sent: send it again"
                )
                entry.decline(Declined(text, NOT_NOW), now_ms)
            elif entry.waits and entry.ground_hold is not None and now_ms >= entry.asked_ms + GROUND_HOLD_MS:
                entry.end(ACCEPTED, now_ms)
            elif entry.waits and now_ms >= entry.next_progress_ms:
                entry.next_progress_ms = now_ms + PROGRESS_MS
                entry.progress()
        for number in [number for number, kept in self._kept.items() if now_ms > kept.until_ms]:
            self._drop_kept(number)

    def _kept_for(self, client: Client, drone: int, command: Command) -> Takeoff | None:
        """The kept takeoff that follows an arm of the same client; any other command to fly gives it up."""
        kept = self._kept.get(drone)
        if kept is None or isinstance(command, Stream | Mavlink):
            return None
        if kept.client == client and isinstance(command, Arm):
            return self._kept.pop(drone).command
        self._drop_kept(drone)
        return None

    def _drop_kept(self, drone: int) -> None:
        client = self._kept.pop(drone).client
        send_text(client.peer, drone, Severity.WARNING, "takeoff given up: no arm followed it")

    def _remember(self, newest: Entry, own: dict[Request, Entry]) -> None:
        """Add a command to its client's `own`; older ones of the same MAV_CMD wait no longer for a COMMAND_ACK.

        COMMAND_ACK cannot tell them apart.
        """
        for entry in own.values():
            if entry.waits and entry.request.mav_cmd == newest.request.mav_cmd:
                entry.waits, entry.ended_ms = False, newest.asked_ms
        own.pop(newest.request, None)
        own[newest.request] = newest
        self._entries[newest.client, newest.drone] = own

    def _drop_old(self, now_ms: int) -> None:
        """Forget the commands of which no repetition comes any more."""
        for key, own in list(self._entries.items()):
            for entry in list(own.values()):
                if not entry.waits and now_ms - entry.ended_ms > NUMBERED_REPEAT_MS:
                    del own[entry.request]
            if not own:
                del self._entries[key]
        self._strangers.clear()
        for (client, _), own in self._entries.items():
            if not self._control.knows(client):
                self._strangers[client.peer] += len(own)

    async def _carry_out(self, entry: Entry, drone: Drone, command: Command) -> None:
        """Carry out a command once its client is alive and may command; a kept takeoff follows an arm."""
        try:
            with declining(entry, self._now_ms):
                await self._control.heard(entry.client)
                self._control.check(entry.client, drone)
                with self._room(entry, command):
                    if not isinstance(command, Stream | Mavlink):
                        self._newest[drone.number] = max(entry.place, self._newest.get(drone.number, 0))
                    if not isinstance(command, Arm | Stream | Mavlink):
                        self._ground_holds.pop(drone.number, None)
                    if entry.is_quiet and isinstance(command, Hold) and self._is_on_ground(drone):
                        entry.ground_hold = asyncio.get_running_loop().create_future()
                        self._ground_holds[drone.number] = entry
                    await self._begin(entry, drone, command)
        finally:
            entry.settle(False)

    @contextlib.contextmanager
    def _room(self, entry: Entry, command: Command) -> Iterator[None]:
        """Count a command as under way; raises Declined if there are too many for its drone."""
        if self._under_way[entry.drone] >= MOST_UNDER_WAY and not isinstance(command, _STOPPING):
            text = f"{name_of(entry.request.mav_cmd)}: {MOST_UNDER_WAY} commands for this drone have no last word yet"
            raise Declined(text, NOT_NOW)
        self._under_way[entry.drone] += 1
        try:
            yield
        finally:
            self._under_way[entry.drone] -= 1

    def _is_on_ground(self, drone: Drone) -> bool:
        """Whether a drone is known to be disarmed: no arm or takeoff from here is open, or newer than that state."""
        view = self._view(drone)
        is_disarmed = view.get(Armed) == Armed(False) and view.is_recent(Armed, VelocityNed, within_ms=HEARD_MS)
        is_newer = view.measured_ms(Armed) > self._risen_ms.get(drone.number, -1)
        return drone.is_reachable and is_disarmed and is_newer and not self._rising[drone.number]

    async def _begin(self, entry: Entry, drone: Drone, command: Command) -> None:
        """Send a command in its turn; raises Declined."""
        if isinstance(command, Takeoff) and await self._comes_before_arming(entry, drone):
            self._control.check(entry.client, drone)
            encode(command)  # raises PayloadError for an altitude that no takeoff has
            self._keep(entry, command)
            return
        if isinstance(command, StartMission | Resume):
            await self._behind_arming(entry, drone)
        if isinstance(command, Arm):
            await self._behind_ground_hold(entry, drone)
        following = self._kept_for(entry.client, drone.number, command)
        if isinstance(command, Arm):
            await self._arm(entry, drone, command, following)
        else:
            await self._send(entry, drone, command)

    async def _comes_before_arming(self, entry: Entry, drone: Drone) -> bool:
        """Whether a takeoff must wait for an arm that has not arrived yet."""
        if await self._behind_arming(entry, drone):
            return False  # without an arm the drone denies it
        arming = self._armings.get(drone.number)
        armed_ms = None if arming is None else arming.completed_ms
        if armed_ms is not None and self._now_ms() - armed_ms <= ARMED_MS:
            return False
        return self._view(drone).get(Armed) == Armed(False)

    async def _behind_arming(self, entry: Entry, drone: Drone) -> bool:
        """Wait for the end of the client's arm if a command comes right after it; returns whether it waited.

        Raises Declined if something else was commanded meanwhile.
        """
        arming = self._armings.get(drone.number)
        if arming is None or arming.client != entry.client or arming.is_over.is_set():
            return False
        await arming.is_over.wait()
        await self._control.heard(entry.client)
        if self._is_outdone(entry):
            raise _given_up(entry)
        return True

    def _is_outdone(self, entry: Entry) -> bool:
        """Whether a newer command came for its drone, or another station took the drone."""
        return entry.place < self._newest.get(entry.drone, 0)

    async def _behind_ground_hold(self, entry: Entry, drone: Drone) -> None:
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
        if self._is_outdone(entry) or not entry.waits:
            raise _given_up(entry)

    async def _arm(self, entry: Entry, drone: Drone, command: Arm, following: Takeoff | None) -> None:
        arming = self._armings[drone.number] = Arming(entry.client, asyncio.Event())
        last = None
        try:
            last = await self._send(entry, drone, command)
        finally:
            arming.completed_ms = self._now_ms() if last is not None and last.completed else None
            arming.is_over.set()
        if following is not None:
            await self._follow(entry, drone, following, last)

    async def _follow(self, entry: Entry, drone: Drone, takeoff: Takeoff, arming: Outcome | None) -> None:
        """Send the takeoff after its arm, unless that failed, its client is gone, or something else was commanded."""
        behind = replace(entry, waits=False)
        with declining(behind, self._now_ms):
            if arming is None or not arming.completed:
                raise Declined("takeoff given up: the drone is not armed")
            await self._control.heard(entry.client)
            if self._is_outdone(entry):
                raise Declined("takeoff given up: another command came")
            if not self._control.has(entry.client, drone):
                raise Declined("takeoff given up: its client has lost control")
            behind.asked_ms = self._now_ms()
            await self._send(behind, drone, takeoff)

    async def _send(self, entry: Entry, drone: Drone, command: Command) -> Outcome | None:
        """Send a command once this station controls the drone; returns its last word, None if it was not sent."""
        with declining(entry, self._now_ms):
            if isinstance(command, _BY_THE_PLAN):
                await self._wait_for_plan(entry, drone)
            async with self._turns.setdefault(drone.number, asyncio.Lock()):
                self._check_order(entry)
                self._control.check(entry.client, drone)
                is_first = not self._control.has(entry.client, drone)
                await self._control.take(entry.client, drone, self._left_s(entry))
                self._check_order(entry)
                sent = drone.send(command, ttl_s=self._left_s(entry))
                if is_first or not isinstance(command, _BESIDE):
                    self._earliest[drone.number] = entry.place
            return await self._last_word(entry, command, sent)
        return None

    async def _last_word(self, entry: Entry, command: Command, sent: SentCommand[Outcome, Outcome]) -> Outcome:
        """Pass the words about a command to its client; returns the last one."""
        rises = isinstance(command, Arm | Takeoff)
        self._rising[entry.drone] += rises
        try:
            async for outcome in sent:
                entry.hear(command, outcome, self._now_ms())
            last = await sent
        finally:
            self._rising[entry.drone] -= rises
        if rises and (last.is_of_activator or last.word not in PASSED_OVER):
            self._risen_ms[entry.drone] = self._now_ms()
        return last

    def _check_order(self, entry: Entry) -> None:
        """Raises Declined for a command that waited while a newer one was sent, or while the drone was taken."""
        if entry.place < self._earliest.get(entry.drone, 0):
            raise _given_up(entry)

    async def _wait_for_plan(self, entry: Entry, drone: Drone) -> None:
        """Wait until the drone has what was uploaded for it; raises Declined if it does not get it.

        This wait does not count in the command's time: its client is alive, waits, and gets IN_PROGRESS every second.
        """
        if self._uploads.is_pending(drone.number):
            what = name_of(entry.request.mav_cmd)
            send_text(entry.client.peer, drone.number, Severity.NOTICE, f"{what} waits until the drone has the plan")
            entry.is_kept = True
            await self._uploads.settled(drone.number)
            entry.is_kept, entry.asked_ms = False, self._now_ms()
            self._check_order(entry)
            if not entry.waits:
                raise _given_up(entry)
            await self._control.heard(entry.client)
        self._uploads.check(entry.client, drone.number)

    async def _change_control(self, entry: Entry, drone: Drone) -> None:
        """MAV_CMD_REQUEST_OPERATOR_CONTROL: 1 takes control from any holder, 0 gives it up."""
        with declining(entry, self._now_ms):
            action = entry.request.whole(1)
            if action not in (0, 1) or (action == 0 and entry.request.params[1]):
                raise Declined("REQUEST_OPERATOR_CONTROL: expected 1 to take control, or 0 and 0 to give it up")
            await self._control.heard(entry.client)
            async with self._turns.setdefault(drone.number, asyncio.Lock()):
                self._check_order(entry)
                if action == 1:
                    await self._control.take_over(entry.client, drone, self._left_s(entry))
                if self._control.has(entry.client, drone):
                    self._earliest[drone.number] = entry.place
                if action == 0:
                    self._control.give_up(entry.client, drone)
            entry.end(ACCEPTED, self._now_ms())

    def _keep(self, entry: Entry, command: Takeoff) -> None:
        """Accept a takeoff and keep it until the arm: QGroundControl arms only after that ACCEPTED."""
        self._kept[entry.drone] = KeptTakeoff(entry.client, command, self._now_ms() + KEPT_MS)
        text = f"takeoff to {command.altitude_m:g} m waits {KEPT_MS // 1000} s for arm"
        send_text(entry.client.peer, entry.drone, Severity.NOTICE, text)
        entry.end(ACCEPTED, self._now_ms())

    def _left_s(self, entry: Entry) -> float:
        """The seconds that are left to start a command, waiting for control included; raises Declined when none is."""
        left_s = self._ttl_s - (self._now_ms() - entry.asked_ms) / 1000
        if left_s <= 0:
            raise Declined(f"{name_of(entry.request.mav_cmd)}: no control in time, not sent", NOT_NOW)
        return left_s


def _given_up(entry: Entry) -> Declined:
    return Declined(f"{name_of(entry.request.mav_cmd)} given up: another command came", CANCELLED)
