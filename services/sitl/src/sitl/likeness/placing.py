"""The side channel of a real autopilot, which is flown into the requested state over its witness's link."""

from __future__ import annotations

import asyncio
import math
import queue
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

from pymavlink.dialects.v20 import development as mavlink

from ..errors import SitlError
from ..real.watching import Watching
from .channel import GCS_COMPONENT, GCS_SYSTEM, Heard, heard_in
from .manners import BY_REQUEST, MANNERS
from .observer import PATIENCE, Timeout
from .pilot import Pilot
from .procedures import FLIGHT_S, up

EXPECTED = '{"set": {"armed": true or false, "altitude_m": metres above home from 0 to 1000}}'
AGAIN_S = 3.0
"""The interval at which a refused or lost command is repeated."""
READY_S = 90.0
"""After a landing its estimator may have to converge again before it arms."""
AT_HOME_M = 3.0
"""From farther away it returns before it lands."""
_LISTENS_S = 0.2


class WitnessChannel:
    """A witness's link in real time, as a channel for a pilot in a thread of its own."""

    def __init__(self, watching: Watching) -> None:
        self._watching = watching
        self._heard: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        self._codec = mavlink.MAVLink(None, GCS_SYSTEM, GCS_COMPONENT)
        self._closed = threading.Event()
        watching.taps.append(self._heard.put)

    @property
    def now_s(self) -> float:
        return time.monotonic()

    def close(self) -> None:
        """Close the link; `listen` raises SitlError then."""
        self._closed.set()
        self._watching.taps.remove(self._heard.put)

    def attend(self, everything: bool) -> None:
        """Ignored: every message is received."""

    def send(self, message: Any) -> None:
        self._watching.send(message.pack(self._codec))
        self._codec.seq = (self._codec.seq + 1) % 256

    def listen(self, seconds: float) -> Iterator[Heard]:
        end_s = self.now_s + seconds
        while (left_s := end_s - self.now_s) > 0:
            if self._closed.is_set():
                raise SitlError("the flight has ended")
            try:
                datagram = self._heard.get(timeout=min(left_s, _LISTENS_S))
            except queue.Empty:
                continue
            yield from heard_in(self.now_s, datagram)


class Placing:
    """Puts the autopilot that a witness watches into a state. `kind` is one of MANNERS."""

    def __init__(self, watching: Watching, kind: str) -> None:
        self._watching = watching
        self._manners = replace(MANNERS[kind], asks=BY_REQUEST)
        self._turn = asyncio.Lock()

    async def answer(self, request: Any) -> dict[str, Any]:
        """Reach the requested state and return it. Raises SitlError if that fails."""
        armed, altitude_m = _wanted(request)
        async with self._turn:
            channel = WitnessChannel(self._watching)
            pilot = Pilot(channel, self._manners, self._watching.witness.system, greets=False)
            try:
                await asyncio.to_thread(put, pilot, armed, altitude_m)
            except Timeout as error:
                raise SitlError(str(error)) from error
            finally:
                channel.close()
        return {"armed": pilot.armed, "mode": pilot.mode, "landed": pilot.landed}


def put(pilot: Pilot, armed: bool, altitude_m: float) -> None:
    """Bring the drone to the ground at home, at rest; then arm it, and fly it to `altitude_m`. Raises Timeout."""
    pilot.begin(everything=False)
    _insist(pilot, "disarmed", lambda: not pilot.armed, lambda: _bring_down(pilot), FLIGHT_S)
    _insist(pilot, pilot.manners.rest, lambda: pilot.rests, pilot.rest, AGAIN_S * 4)
    if not armed:
        return
    pilot.begin(everything=False)  # heights count from the ground
    pilot.until("ready", lambda: pilot.ready, READY_S)
    _insist(pilot, "armed", lambda: pilot.armed, pilot.arm, READY_S)
    if altitude_m:
        up(pilot, altitude_m)


def _bring_down(pilot: Pilot) -> None:
    if pilot.landed:
        pilot.disarm()
    elif pilot.mode not in ("land", "return"):
        at = pilot.last["LOCAL_POSITION_NED"]
        if math.hypot(at.x, at.y) > AT_HOME_M:
            pilot.set_mode("return")
        else:
            pilot.land()


def _insist(pilot: Pilot, name: str, is_so: Callable[[], bool], command: Callable[[], object], limit_s: float) -> None:
    """Repeat a command until `is_so`. Raises Timeout, also if the autopilot is silent and so its clock stands still."""
    end_s, given_up_s = pilot.now_s + limit_s, time.monotonic() + PATIENCE * limit_s
    while not is_so():
        command()
        try:
            pilot.until("", is_so, AGAIN_S)
        except Timeout:
            if pilot.now_s >= end_s or time.monotonic() >= given_up_s:
                raise Timeout(f"{name}: not within {limit_s:g} s: {pilot.case.acks[-3:]}") from None


def _wanted(request: Any) -> tuple[bool, float]:
    wanted = request.get("set") if isinstance(request, dict) and set(request) == {"set"} else None
    if not isinstance(wanted, dict) or not {"armed"} <= set(wanted) <= {"armed", "altitude_m"}:
        raise SitlError(f"{request}: of a real autopilot expected {EXPECTED}")
    armed, altitude_m = wanted["armed"], wanted.get("altitude_m", 0)
    is_height = isinstance(altitude_m, int | float) and not isinstance(altitude_m, bool) and 0 <= altitude_m <= 1000
    if not isinstance(armed, bool) or not is_height or (altitude_m and not armed):
        raise SitlError(f"{request}: of a real autopilot expected {EXPECTED}, in the air armed")
    return armed, float(altitude_m)
