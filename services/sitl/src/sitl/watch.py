"""Writes down when an autopilot that is not the stand-in arms and disarms, as its own heartbeats say."""

from __future__ import annotations

import json
import socket
import time
from pathlib import Path
from typing import TextIO

from pymavlink.dialects.v20 import common as mavlink

from .errors import SitlError


class Witness:
    """What one autopilot's heartbeats have said so far."""

    def __init__(self, system: int) -> None:
        self._system = system
        self._armed = False

    def take(self, datagram: bytes) -> list[str]:
        """`armed` or `disarmed` for each change that a datagram tells of."""
        events = []
        parser = mavlink.MAVLink(None)  # a new one each time: messages do not go on from one datagram to the next
        parser.robust_parsing = True
        for message in parser.parse_buffer(datagram) or ():
            sender = (message.get_srcSystem(), message.get_srcComponent())
            if message.get_type() != "HEARTBEAT" or sender != (self._system, mavlink.MAV_COMP_ID_AUTOPILOT1):
                continue
            armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
            if armed != self._armed:
                self._armed = armed
                events.append("armed" if armed else "disarmed")
        return events


def watch(system: int, listen: tuple[str, int], events: Path) -> None:
    """Listen until the process ends; each event a line as the stand-in's. Raises SitlError for a port or a file."""
    witness = Witness(system)
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock, events.open("a", encoding="utf-8") as log:
            sock.bind(listen)
            while True:
                for event in witness.take(sock.recv(2048)):
                    _write(log, event)
    except OSError as error:
        raise SitlError(f"{listen[0]}:{listen[1]} or {events}: {error.strerror}") from error


def _write(log: TextIO, event: str) -> None:
    log.write(json.dumps({"t_ns": time.time_ns(), "event": event}) + "\n")
    log.flush()
