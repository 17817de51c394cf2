"""Requests that the gateway answers itself: for messages and files (docs/gateway.md)."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any, Final

from pymavlink.dialects.v20 import common as mavlink

from .clients import Client
from .telemetry import LOCAL, Turns, View
from .translation import NOT_NOW, UNSUPPORTED, Request

ACCEPTED = int(mavlink.MAV_RESULT_ACCEPTED)
TEXT_MS = 10_000
"""How long the same text is not sent to a client again."""

_NAMES: Final = {getattr(mavlink, f"MAVLINK_MSG_ID_{name}"): name for name in LOCAL}
_FTP_HEAD = struct.Struct("<HBBBBBBI")
_FTP_BYTES = 251
_FTP_NAK, _FTP_FILE_NOT_FOUND = 129, 10
_STEERING = "set-points and sticks do not pass this gateway: they would come late; expected commands"

Answer = tuple[list[Any], str | None]
"""The messages of an answer, and a text for people."""


class Answers:
    """Answers for all drones; none of them crosses a link."""

    def __init__(self, turns: Turns) -> None:
        self._turns = turns
        self._told_ms: dict[tuple[Client, int, str], int] = {}
        self._handlers: dict[str, Callable[[Any, Client, View], Answer]] = {
            "FILE_TRANSFER_PROTOCOL": _no_file,
            "MANUAL_CONTROL": _refuse_steering,
            "RC_CHANNELS_OVERRIDE": _refuse_steering,
            "SET_POSITION_TARGET_LOCAL_NED": _refuse_steering,
            "SET_POSITION_TARGET_GLOBAL_INT": _refuse_steering,
            "SET_ATTITUDE_TARGET": _refuse_steering,
            "SET_ACTUATOR_CONTROL_TARGET": _refuse_steering,
        }

    def on_message(self, message: Any, client: Client, view: View) -> Answer:
        """The answer to a message that is no command; a text is not repeated within ten seconds."""
        handler = self._handlers.get(message.get_type())
        if handler is None:
            return [], None
        messages, text = handler(message, client, view)
        if text is not None:
            while self._told_ms and view.now_ms - next(iter(self._told_ms.values())) >= TEXT_MS:
                del self._told_ms[next(iter(self._told_ms))]  # they are in the order of their times
            if (client, view.number, text) in self._told_ms:
                return messages, None
            self._told_ms[client, view.number, text] = view.now_ms
        return messages, text

    def on_command(self, request: Request, view: View) -> tuple[int, Any | None] | None:
        """The result of a command that the gateway carries out, and a message to send before; None for any other."""
        if request.mav_cmd == mavlink.MAV_CMD_REQUEST_MESSAGE:
            return _requested(_NAMES.get(request.whole(1)), view)
        if request.mav_cmd == mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES:
            return _requested("AUTOPILOT_VERSION", view)
        if request.mav_cmd == mavlink.MAV_CMD_GET_HOME_POSITION:
            return _requested("HOME_POSITION", view)
        if request.mav_cmd in (mavlink.MAV_CMD_REQUEST_PROTOCOL_VERSION, mavlink.MAV_CMD_GET_MESSAGE_INTERVAL):
            return UNSUPPORTED, None
        if request.mav_cmd == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL and request.whole(1) in _NAMES:
            interval_us = request.params[1]
            if interval_us is not None and interval_us > 0:
                self._turns.ask(view.number, _NAMES[request.whole(1)], 1e6 / interval_us)
            return ACCEPTED, None
        return None


def _requested(name: str | None, view: View) -> tuple[int, Any | None]:
    if name is None:
        return UNSUPPORTED, None
    made = LOCAL[name].make(view)
    return (NOT_NOW, None) if made is None else (ACCEPTED, made)


def _no_file(message: Any, client: Client, view: View) -> Answer:
    """Answer that there is no such file: without an answer a client asks for seconds."""
    number, session, asked, *_ = _FTP_HEAD.unpack_from(bytes(message.payload))
    head = _FTP_HEAD.pack((number + 1) % 2**16, session, _FTP_NAK, 1, asked, 0, 0, 0) + bytes([_FTP_FILE_NOT_FOUND])
    payload = list(head.ljust(_FTP_BYTES, b"\0"))
    return [mavlink.MAVLink_file_transfer_protocol_message(0, client.system, client.component, payload)], None


def _refuse_steering(message: Any, client: Client, view: View) -> Answer:
    return [], _STEERING
