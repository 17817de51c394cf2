"""An autopilot that is always armed, acknowledges every arming, and records when the kernel received it."""

from __future__ import annotations

import asyncio
import socket
import struct
from collections import Counter
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

_SO_TIMESTAMPNS = 35
"""Linux: each datagram is read with the time at which the kernel received it."""
_PX4_HOLD = 4 << 16 | 3 << 24
_HEARTBEAT = mavlink.MAVLink_heartbeat_message(2, 12, mavlink.MAV_MODE_FLAG_SAFETY_ARMED, _PX4_HOLD, 4, 3)
_HEARTBEAT_S = 0.5


class AlwaysArmed:
    """Sends its heartbeats to a port of loopback, from a socket that receives the answers."""

    def __init__(self, port: int) -> None:
        self.heard_ns: list[int] = []
        """When each arming was received, in Unix time."""
        self.kinds: Counter[str] = Counter()
        """Counts of received messages by name; commands with their number."""
        self._codec = mavlink.MAVLink(None, 1, 1)
        self._parser = mavlink.MAVLink(None)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        self._socket.connect(("127.0.0.1", port))
        self._socket.setblocking(False)
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(self._socket, self._read)
        self._living = asyncio.create_task(self._live())

    def close(self) -> None:
        self._living.cancel()
        self._loop.remove_reader(self._socket)
        self._socket.close()

    def _read(self) -> None:
        try:
            data, ancillary, _, _ = self._socket.recvmsg(2048, 64)
        except (BlockingIOError, ConnectionRefusedError):  # nobody listened there when it sent its last heartbeat
            return
        seconds, nanoseconds = struct.unpack("qq", ancillary[0][2])
        for message in self._parser.parse_buffer(data) or ():
            self._take(message, seconds * 1_000_000_000 + nanoseconds)

    def _take(self, message: Any, received_ns: int) -> None:
        kind = message.get_type()
        if kind != "COMMAND_LONG":
            self.kinds[kind] += 1
            return
        self.kinds[f"{kind} {message.command}"] += 1
        arming = message.command == mavlink.MAV_CMD_COMPONENT_ARM_DISARM
        result = mavlink.MAV_RESULT_ACCEPTED if arming else mavlink.MAV_RESULT_UNSUPPORTED
        asked = (message.get_srcSystem(), message.get_srcComponent())
        # Its sequence numbers come again within milliseconds: equal acknowledgements would be copies (R5.6).
        told = len(self.heard_ns)
        self._send(mavlink.MAVLink_command_ack_message(message.command, result, 0, told, *asked))
        if arming:
            self.heard_ns.append(received_ns)
            self._send(_HEARTBEAT)

    async def _live(self) -> None:
        while True:
            self._send(_HEARTBEAT)
            await asyncio.sleep(_HEARTBEAT_S)

    def _send(self, message: Any) -> None:
        try:
            self._socket.send(message.pack(self._codec))
        except ConnectionRefusedError:  # as in _read
            return
        self._codec.seq = (self._codec.seq + 1) % 256
