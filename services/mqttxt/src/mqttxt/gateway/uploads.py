"""Plans from clients to drones: received item by item, sent as one, acknowledged in time (docs/gateway.md)."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Iterator
from typing import Any, Final

from pymavlink.dialects.v20 import common as mavlink

from ..drone.mavlink.mission_protocol import result_name
from ..errors import BrokerRefused, ConfigurationError, FogUnreachable, PayloadError, StationEnded, TransferFailed
from ..protocol.messages import Word
from ..protocol.plans import PlanList, PlanObject
from ..protocol.states import Severity
from ..station.outcomes import Outcome
from ..station.plan import Plan
from ..station.views import CARRIED_S, Drone
from .clients import Client
from .plan_copies import PlanCopies
from .plan_items import WrongItem, check_count, home_items, item_from, plan_list
from .translation import NOT_NOW, Declined
from .upload import Upload
from .work import Work, Worker

ACK_MS = 1000
"""How long the last MISSION_ACK waits for the drone's word. QGroundControl gives up after 1.5 s, MAVSDK after 2.5 s."""
ASK_AGAIN_MS = 500
BROKEN_OFF_MS = 5000
"""How long an upload waits for its next item: longer than a client keeps answering a request."""
_Who = tuple[int, int]
"""A client's system and component, which it has also when it connects anew."""
_RESULTS: Final = {result_name(result): result for result in mavlink.enums["MAV_MISSION_RESULT"]}


class Uploads(Worker):
    """The uploads of all clients; each that is under way has a task. Times are of the gateway's clock."""

    def __init__(self, work: Work, copies: PlanCopies) -> None:
        super().__init__(work)
        self._copies = copies
        self._open: list[Upload] = []
        self._failures: dict[tuple[int, PlanList], dict[_Who | None, str]] = {}
        self._turns: dict[int, asyncio.Lock] = {}

    def begin(self, client: Client, drone: Drone, kind: PlanList, count: int) -> None:
        """MISSION_COUNT, or MISSION_CLEAR_ALL, which is a list without items."""
        known = self._receiving(drone.number, kind)
        if known is not None:
            if known.client == client and (known.count, known.received) == (count, 0):
                known.heard_ms = self._now_ms()
                if known.is_asking:
                    known.ask(known.heard_ms)
                return
            if known.client == client:
                self._drop(known)
        elif not count and self._is_clearing(client, drone, kind):
            return
        upload = Upload(client, drone, kind, count, self._now_ms())
        try:
            upload.before = home_items(kind, self._view(drone))
            self._control.check(client, drone)
            if known is not None and known.client != client and not self._control.knows(client):
                raise Declined(f"{kind.label} upload: {known.client} is uploading, and {client} sends no HEARTBEAT")
            check_count(count - upload.before, kind)
        except (Declined, WrongItem) as error:
            upload.acknowledge(_result_of(error))
            upload.say(Severity.WARNING, str(error))
            return
        if known is not None and known.client != client:
            self._end(known, mavlink.MAV_MISSION_OPERATION_CANCELLED, f"{kind.label} upload: {client} took control")
        self._open.append(upload)
        upload.task = self._group.create_task(self._carry(upload))

    def on_item(self, client: Client, drone: Drone, kind: PlanList, message: Any) -> None:
        """MISSION_ITEM_INT or MISSION_ITEM; any but the one asked for is ignored."""
        upload = self._receiving(drone.number, kind)
        if upload is None or upload.client != client or not upload.is_asking or message.seq != upload.received:
            return
        upload.heard_ms = self._now_ms()
        try:
            if message.seq >= upload.before:
                upload.items.append(item_from(message, kind, message.seq + 1 - upload.before))
            upload.received += 1
            if upload.received < upload.count:
                upload.ask(upload.heard_ms)
            else:
                self._receive(upload)
        except WrongItem as wrong:
            self._end(upload, wrong.result, str(wrong))

    def on_cancel(self, client: Client, drone: Drone, kind: PlanList) -> None:
        """A client gives up its upload; one that was received completely goes on."""
        upload = self._receiving(drone.number, kind)
        if upload is not None and upload.client == client:
            self._end(upload, mavlink.MAV_MISSION_OPERATION_CANCELLED, _broken_off(upload))

    def tick(self, now_ms: int) -> None:
        """Send due acknowledgements, ask again for items, and end uploads that broke off or that lost control."""
        for upload in list(self._open):
            if upload.is_received:
                if not self._control.has(upload.client, upload.drone):
                    text = f"{upload.kind.label} upload: control is lost; the drone may have the new list"
                    self._fail(upload, mavlink.MAV_MISSION_OPERATION_CANCELLED, text)
                elif now_ms >= upload.ack_ms:
                    upload.acknowledge(mavlink.MAV_MISSION_ACCEPTED)
            elif now_ms - upload.heard_ms >= BROKEN_OFF_MS:
                self._end(upload, mavlink.MAV_MISSION_OPERATION_CANCELLED, _broken_off(upload))
            elif upload.is_asking and now_ms - upload.asked_ms >= ASK_AGAIN_MS:
                upload.ask(now_ms)

    def close(self) -> None:
        """Drop all uploads."""
        for upload in list(self._open):
            self._drop(upload)

    def is_pending(self, drone: int) -> bool:
        """Whether a plan was received for a drone whose outcome is not known yet."""
        return bool(self._pending(drone))

    async def settled(self, drone: int) -> None:
        """Wait until every plan received for a drone is verified or has failed."""
        while pending := self._pending(drone):
            await asyncio.wait([upload.task for upload in pending if upload.task is not None])

    def check(self, client: Client, drone: int) -> None:
        """Raises Declined if a plan was acknowledged and the drone did not take it: the client's, or the newest one."""
        for kind in PlanList:
            failed = self._failures.get((drone, kind), {})
            text = failed.get((client.system, client.component)) or failed.get(None)
            if text is not None:
                raise Declined(f"{text}: upload it again, clear it, or read what the drone has")

    def forgive(self, client: Client, drone: int, kind: PlanList) -> None:
        """A client learns which list the drone has, or uploads the list: forget its own failure, and the newest one.

        Another client whose list failed has to learn it, too.
        """
        for who in ((client.system, client.component), None):
            self._failures.get((drone, kind), {}).pop(who, None)

    def mission(self, client: Client, drone: int) -> bytes | None:
        """The hash of the mission that a client means."""
        return self._copies.mission(client, drone)

    def _receiving(self, drone: int, kind: PlanList) -> Upload | None:
        found = (one for one in self._open if (one.drone.number, one.kind) == (drone, kind) and not one.is_received)
        return next(found, None)

    def _is_clearing(self, client: Client, drone: Drone, kind: PlanList) -> bool:
        """Whether the client already asked to clear the list: clients repeat that until it is acknowledged."""
        key = (client, drone.number, kind, 0)
        return any(
            (one.client, one.drone.number, one.kind, one.count) == key and not one.is_acked for one in self._open
        )

    def _pending(self, drone: int) -> list[Upload]:
        return [one for one in self._open if one.drone.number == drone and one.is_received]

    def _is_replaced(self, upload: Upload) -> bool:
        """Whether an upload's client has since sent the same list for the same drone: it means that one."""
        pending = self._pending(upload.drone.number)
        behind = pending[pending.index(upload) + 1 :] if upload in pending else []
        return any((one.client, one.kind) == (upload.client, upload.kind) for one in behind)

    async def _carry(self, upload: Upload) -> None:
        """Carry one list from its count to its end."""
        asked_ms = self._now_ms()
        with self._failing(upload):
            await self._control.heard(upload.client)
            self._control.check(upload.client, upload.drone, asked_ms)
            if upload.count:
                upload.ask(self._now_ms())
            else:
                self._receive(upload)
            await self._control.take(upload.client, upload.drone, self._ttl_s)
            await upload.whole.wait()
            async with self._turns.setdefault(upload.drone.number, asyncio.Lock()):
                if not self._control.has(upload.client, upload.drone):
                    raise Declined(f"{upload.kind.label} upload: control is lost, not sent: the old one stays")
                if not upload.is_over:
                    await self._send(upload)

    def _receive(self, upload: Upload) -> None:
        """Complete an upload whose items are all received; raises WrongItem if they do not fit together.

        It replaces one of the same list and client that still waits. That one gets no MISSION_ACK, which its client
        would take for the new one's.
        """
        items = plan_list(tuple(upload.items), upload.kind, upload.before)
        for older in self._pending(upload.drone.number):
            if (older.client, older.kind) == (upload.client, upload.kind) and not older.is_begun:
                older.say(Severity.NOTICE, f"{older.kind.label} upload: a newer list replaces it")
                self._drop(older)
        upload.items, upload.ack_ms = list(items), self._now_ms() + ACK_MS
        upload.whole.set()
        self.forgive(upload.client, upload.drone.number, upload.kind)
        if upload.kind is PlanList.MISSION:
            self._copies.name(upload.client, upload.drone.number, items)

    async def _send(self, upload: Upload) -> None:
        """Send a list to its drone, together with the client's other lists that are received by now."""
        together = [one for one in self._pending(upload.drone.number) if one.client == upload.client]
        for one in together:
            one.is_begun = True
        lists = {one.kind: tuple(one.items) for one in together}
        outcome = await upload.drone.upload(Plan(PlanObject.of(lists)), timeout_s=CARRIED_S)
        if outcome.completed:
            self._copies.put(upload.drone.number, lists)
        for one in together:
            if outcome.completed:
                late = f"{one.kind.label} upload completed: {len(one.items)} items" if one.is_acked else None
                self._end(one, mavlink.MAV_MISSION_ACCEPTED, late, Severity.INFO)
            else:
                self._fail(one, _result(outcome), f"{one.kind.label} upload {_told(outcome)}")

    @contextlib.contextmanager
    def _failing(self, upload: Upload) -> Iterator[None]:
        """Turn errors into a failed upload; where the station ends, the outcome is not known, and none is sent."""
        try:
            yield
        except Declined as declined:
            self._fail(upload, _result_of(declined), str(declined))
        except PayloadError as error:
            self._fail(upload, mavlink.MAV_MISSION_NO_SPACE, f"{upload.kind.label} upload: {error}")
        except ConfigurationError as error:
            self._fail(upload, mavlink.MAV_MISSION_DENIED, f"{upload.kind.label} upload: {error}")
        except (FogUnreachable, TransferFailed) as error:
            self._fail(upload, mavlink.MAV_MISSION_ERROR, f"{upload.kind.label} upload: {error}")
        except (StationEnded, BrokerRefused):
            self._drop(upload)

    def _fail(self, upload: Upload, result: int, text: str) -> None:
        """Fail a list that the drone does not have; a client that got ACCEPTED for it must not fly by it."""
        if upload.is_over:
            return
        if upload.is_received:
            self._copies.forget(upload.drone.number)
        if upload.is_acked and not self._is_replaced(upload):
            who = (upload.client.system, upload.client.component)
            self._failures.setdefault((upload.drone.number, upload.kind), {}).update({who: text, None: text})
        self._end(upload, result, text)

    def _end(self, upload: Upload, result: int, text: str | None, severity: Severity = Severity.WARNING) -> None:
        upload.acknowledge(result)
        if text is not None:
            upload.say(severity, text)
        self._drop(upload)

    def _drop(self, upload: Upload) -> None:
        upload.is_over = True
        if upload in self._open:
            self._open.remove(upload)
        if upload.task is not None and upload.task is not asyncio.current_task():
            upload.task.cancel()


def _result_of(error: Declined | WrongItem) -> int:
    if isinstance(error, WrongItem):
        return error.result
    return int(mavlink.MAV_MISSION_ERROR if error.result == NOT_NOW else mavlink.MAV_MISSION_DENIED)


def _result(outcome: Outcome) -> int:
    """The drone's word as a MAV_MISSION_RESULT: the autopilot's own about an item, if the reason ends in one."""
    said = _RESULTS.get((outcome.reason or "").rpartition(": ")[2])
    if said is not None:
        return int(said)
    return int(mavlink.MAV_MISSION_DENIED if outcome.word is Word.DENIED else mavlink.MAV_MISSION_ERROR)


def _told(outcome: Outcome) -> str:
    return str(outcome).partition(f"{outcome.command} ")[2]


def _broken_off(upload: Upload) -> str:
    return f"{upload.kind.label} upload broke off at item {upload.received + 1} of {upload.count}: the old one stays"
