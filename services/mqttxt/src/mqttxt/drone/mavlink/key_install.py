"""Installs a MAVLink key in an autopilot by SETUP_SIGNING, which only its signed heartbeats acknowledge."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from typing import Any, Final

from pymavlink.dialects.v20 import common as mavlink

from ...errors import ConfigurationError, TransportError
from .frame_parser import Malformed
from .link import AutopilotLink
from .plans import AUTOPILOT_COMPONENT
from .signing import NotTrusted, Signing
from .stamps import Stamps
from .transports import AutopilotAddress

PATIENCE_S: Final = 10.0
AGAIN_S: Final = 1.0
_HINT: Final = (
    "PX4 signs from 1.18 on; an autopilot that has a key takes another with --old, or over its USB port (ArduPilot)"
)


def check_wired(address: AutopilotAddress) -> None:
    """Raises ConfigurationError for an address that is not on this machine, because the key is sent in the clear."""
    if address.kind != "serial" and address.host not in ("127.0.0.1", "localhost"):
        raise ConfigurationError(
            f"--install {address}: the key would cross a network in the clear; expected serial:DEVICE:BAUD"
        )


class Installation:
    """Gives the autopilot of `drone` the key, in messages that are signed with `old` if it already has that key."""

    def __init__(self, address: AutopilotAddress, drone: int, key: bytes, old: bytes | None = None) -> None:
        signing = Signing(old, Stamps()) if old is not None else None
        self._link = AutopilotLink(address, drone, self._on_readable, self._on_malformed, signing)
        self._drone = drone
        self._key = key
        self._new = Signing(key, Stamps())
        self._heard = asyncio.Event()
        self._signs = asyncio.Event()
        self._is_armed = False
        self._text = ""

    async def run(self) -> None:
        """Run until the autopilot signs with the key. Raises TransportError with the reason if it does not."""
        reading = asyncio.create_task(self._link.run())
        try:
            await self._wait(self._heard, f"no valid heartbeat of system {self._drone}")
            if self._is_armed:
                raise TransportError(f"drone {self._drone} is armed; disarm it before the autopilot takes a key")
            await self._wait(self._signs, f"it does not sign with this key. {_HINT}", self._say)
        finally:
            reading.cancel()
            await asyncio.wait({reading})

    def _say(self) -> None:
        stamp = self._new.stamps.now()
        self._link.write(
            mavlink.MAVLink_setup_signing_message(self._drone, AUTOPILOT_COMPONENT, list(self._key), stamp)
        )

    async def _wait(self, event: asyncio.Event, otherwise: str, each: Callable[[], None] | None = None) -> None:
        loop = asyncio.get_running_loop()
        until_s = loop.time() + PATIENCE_S
        while not event.is_set():
            if loop.time() >= until_s:
                said = f" It said: {self._text}" if self._text else ""
                raise TransportError(f"autopilot {self._link.address}: {otherwise}.{said}")
            if each is not None:
                each()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(AGAIN_S):
                    await event.wait()

    def _on_readable(self) -> None:
        for message in self._link.messages():
            self._on_message(message)

    def _on_message(self, message: Any) -> None:
        if (message.get_srcSystem(), message.get_srcComponent()) != (self._drone, AUTOPILOT_COMPONENT):
            return
        if message.get_type() == "HEARTBEAT":
            self._is_armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
            self._heard.set()
        elif message.get_type() == "STATUSTEXT":
            self._text = message.text
        self._look(message)

    def _on_malformed(self, found: Malformed) -> None:
        if isinstance(found, NotTrusted):
            self._look(found.message)

    def _look(self, message: Any) -> None:
        """Note if a heartbeat is signed with the new key, whatever its time stamp."""
        if message.get_type() != "HEARTBEAT" or message.get_srcSystem() != self._drone:
            return
        verdict = self._new.judge(message, asyncio.get_running_loop().time())
        if not isinstance(verdict, NotTrusted) or verdict.is_stale:
            self._heard.set()
            self._signs.set()
