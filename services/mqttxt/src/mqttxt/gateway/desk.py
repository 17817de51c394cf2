"""Clients' commands, from their first COMMAND_ACK to their last word (docs/gateway.md)."""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

from ..protocol.codec import encode
from ..protocol.commands import Arm, Command, Resume, StartMission, Takeoff
from ..protocol.states import Severity
from ..station.heard import SentCommand
from ..station.outcomes import Outcome
from ..station.views import Drone
from .answers import ACCEPTED
from .arming import ArmingOrder
from .client_commands import (
    FIRST_PROGRESS_MS,
    GROUND_HOLD_MS,
    MODE_PATIENCE_MS,
    PROGRESS_MS,
    STOPPING,
    ClientCommand,
    acknowledge,
    declining,
    is_quiet,
)
from .clients import Client
from .order import BY_THE_PLAN, CommandOrder
from .requests import Requests
from .texts import send_text
from .translation import NOT_NOW, REQUEST_OPERATOR_CONTROL, Declined, Request, command_of, name_of
from .uploads import Uploads
from .work import Work, Worker

UNANSWERED_MS = 10_000
"""How long to wait for a command's first word after the last moment at which the command may start."""
MOST_UNDER_WAY = 32
"""Commands for one drone without a last word; those that stop it are not limited."""


class Desk(Worker):
    """The commands of all clients, each followed by a task."""

    def __init__(self, work: Work, uploads: Uploads) -> None:
        super().__init__(work)
        self._uploads = uploads
        self._requests = Requests(work.control.knows)
        self._order = CommandOrder()
        self._arming = ArmingOrder(work, self._order)
        self._under_way = Counter[int]()

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
        repeated = self._requests.repeated(client, drone.number, request, confirmation, view.now_ms)
        if repeated is not None:
            repeated.repeat(view.now_ms)
            return
        if not self._requests.has_room(client):
            acknowledge(client, drone.number, request, NOT_NOW)
            return
        due_ms, place = view.now_ms + FIRST_PROGRESS_MS, self._order.next_place()
        entry = ClientCommand(client, drone.number, request, view.now_ms, due_ms, place, confirmation)
        self._requests.add(entry)
        try:
            if is_late:
                text = f"{name_of(request.mav_cmd)} not sent: it waited while the gateway stood still"
                raise Declined(text, NOT_NOW)
            if request.mav_cmd == REQUEST_OPERATOR_CONTROL:
                self._group.create_task(self._change_control(entry, drone))
                return
            meant = replace(view, named=self._uploads.mission(client, drone.number))
            command = command_of(request, meant, takeoff_m)
            entry.command, entry.is_quiet = command, is_quiet(request, command)
            self._group.create_task(self._carry_out(entry, drone, command))
        except Declined as declined:
            entry.decline(declined, self._now_ms())

    def on_taken(self, drone: int) -> None:
        """Another station controls a drone now: revoke what still waits, so that it does not take the drone back."""
        self._order.on_taken(drone)
        self._arming.on_taken(drone)

    def on_stall(self) -> None:
        """The gateway stood still: revoke what waits for a plan, an arm or a hold, which has no time of its own."""
        self._order.on_stall()

    def tick(self, now_ms: int) -> None:
        """Send IN_PROGRESS for waiting commands; end unanswered ones, modes that waited too long, and kept takeoffs."""
        self._requests.drop_old(now_ms)
        self._arming.tick(now_ms)
        for entry in self._requests:
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

    async def _carry_out(self, entry: ClientCommand, drone: Drone, command: Command) -> None:
        """Carry out a command once its client is alive and may command; a kept takeoff follows an arm."""
        try:
            with declining(entry, self._now_ms):
                await self._control.heard(entry.client)
                self._control.check(entry.client, drone)
                with self._room(entry, command):
                    self._order.on_permitted(entry, command)
                    self._arming.on_permitted(entry, drone, command)
                    await self._begin(entry, drone, command)
        finally:
            entry.settle(False)

    @contextlib.contextmanager
    def _room(self, entry: ClientCommand, command: Command) -> Iterator[None]:
        """Count a command as under way; raises Declined if there are too many for its drone."""
        if self._under_way[entry.drone] >= MOST_UNDER_WAY and not isinstance(command, STOPPING):
            text = f"{name_of(entry.request.mav_cmd)}: {MOST_UNDER_WAY} commands for this drone have no last word yet"
            raise Declined(text, NOT_NOW)
        self._under_way[entry.drone] += 1
        try:
            yield
        finally:
            self._under_way[entry.drone] -= 1

    async def _begin(self, entry: ClientCommand, drone: Drone, command: Command) -> None:
        """Send a command in its turn; raises Declined."""
        if isinstance(command, Takeoff) and await self._arming.comes_before(entry, drone):
            self._control.check(entry.client, drone)
            encode(command)  # raises PayloadError for an altitude that no takeoff has
            self._arming.keep(entry, command)
            return
        if isinstance(command, StartMission | Resume):
            await self._arming.behind(entry, drone)
        if isinstance(command, Arm):
            await self._arming.behind_ground_hold(entry, drone)
        following = self._arming.kept_for(entry.client, drone.number, command)
        if isinstance(command, Arm):
            await self._arm(entry, drone, command, following)
        else:
            await self._send(entry, drone, command)

    async def _arm(self, entry: ClientCommand, drone: Drone, command: Arm, following: Takeoff | None) -> None:
        with self._arming.arming(entry.client, drone.number) as arming:
            last = await self._send(entry, drone, command)
            arming.completed_ms = self._now_ms() if last is not None and last.completed else None
        if following is not None:
            await self._follow(entry, drone, following, last)

    async def _follow(self, entry: ClientCommand, drone: Drone, takeoff: Takeoff, arming: Outcome | None) -> None:
        """Send the takeoff after its arm, unless that failed, its client is gone, or something else was commanded."""
        behind = replace(entry, waits=False)
        with declining(behind, self._now_ms):
            if arming is None or not arming.completed:
                raise Declined("takeoff given up: the drone is not armed")
            await self._control.heard(entry.client)
            if self._order.is_outdone(entry):
                raise self._order.given_up(entry, "takeoff")
            if not self._control.has(entry.client, drone):
                raise Declined("takeoff given up: its client has lost control")
            behind.asked_ms = self._now_ms()
            await self._send(behind, drone, takeoff)

    async def _send(self, entry: ClientCommand, drone: Drone, command: Command) -> Outcome | None:
        """Send a command once this station controls the drone; returns its last word, None if it was not sent."""
        with declining(entry, self._now_ms):
            if isinstance(command, BY_THE_PLAN):
                await self._wait_for_plan(entry, drone)
            async with self._order.turn(drone.number):
                self._order.check(entry)
                self._control.check(entry.client, drone)
                is_first = not self._control.has(entry.client, drone)
                await self._control.take(entry.client, drone, self._time_left_s(entry))
                self._order.check(entry)
                sent = drone.send(command, ttl_s=self._time_left_s(entry))
                self._order.on_sent(entry, command, is_first)
            return await self._last_word(entry, command, sent)
        return None

    async def _last_word(self, entry: ClientCommand, command: Command, sent: SentCommand[Outcome, Outcome]) -> Outcome:
        """Pass the words about a command to its client; returns the last one."""
        with self._arming.rising(entry.drone, command):
            async for outcome in sent:
                entry.hear(command, outcome, self._now_ms())
            last = await sent
        self._arming.on_last_word(entry.drone, command, last)
        return last

    async def _wait_for_plan(self, entry: ClientCommand, drone: Drone) -> None:
        """Wait until the drone has what was uploaded for it; raises Declined if it does not get it.

        This wait does not count in the command's time: its client is alive, waits, and gets IN_PROGRESS every second.
        """
        if self._uploads.is_pending(drone.number):
            what = name_of(entry.request.mav_cmd)
            send_text(entry.client.peer, drone.number, Severity.NOTICE, f"{what} waits until the drone has the plan")
            entry.is_kept = True
            await self._uploads.settled(drone.number)
            entry.is_kept, entry.asked_ms = False, self._now_ms()
            self._order.check(entry)
            if not entry.waits or self._order.is_stale(entry):
                raise self._order.given_up(entry)
            await self._control.heard(entry.client)
        self._uploads.check(entry.client, drone.number)

    async def _change_control(self, entry: ClientCommand, drone: Drone) -> None:
        """MAV_CMD_REQUEST_OPERATOR_CONTROL: 1 takes control from any holder, 0 gives it up."""
        with declining(entry, self._now_ms):
            action = entry.request.whole(1)
            if action not in (0, 1) or (action == 0 and entry.request.params[1]):
                raise Declined("REQUEST_OPERATOR_CONTROL: expected 1 to take control, or 0 and 0 to give it up")
            await self._control.heard(entry.client)
            async with self._order.turn(drone.number):
                self._order.check(entry)
                if action == 1:
                    await self._control.take_over(entry.client, drone, self._time_left_s(entry))
                if self._control.has(entry.client, drone):
                    self._order.close_behind(entry)
                if action == 0:
                    self._control.give_up(entry.client, drone)
            entry.end(ACCEPTED, self._now_ms())

    def _time_left_s(self, entry: ClientCommand) -> float:
        """The seconds that are left to start a client's command; raises Declined when none is."""
        return self._left_s(entry.asked_ms, f"{name_of(entry.request.mav_cmd)}: ")
