"""A pilot's ground station that signs, by pymavlink alone: system 255, component 190 and link id 0, as in QGC."""

from __future__ import annotations

import socket
import threading
import time
from typing import Any, Self

from pymavlink.dialects.v20 import common as mavlink

from mqttxt.drone.mavlink.stamps import Stamps

BEAT_S = 0.5


class KeyedPilot:
    """Sends heartbeats to the autopilot at `port` and receives what that signs; without `key` nothing is signed."""

    def __init__(self, port: int, system: int, key: bytes | None) -> None:
        self.latest: dict[str, Any] = {}
        self.results: list[tuple[int, int]] = []
        """MAV_CMD and MAV_RESULT of each COMMAND_ACK to this station."""
        self._system = system
        self._codec = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
        self._codec.robust_parsing = True
        if key is not None:
            signing = self._codec.signing
            signing.secret_key, signing.sign_outgoing = key, True
            signing.timestamp = Stamps().now()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect(("127.0.0.1", port))
        self._socket.settimeout(0.1)
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()
        self._socket.close()

    def command(self, mav_cmd: int, *params: float) -> None:
        self._say(mavlink.MAVLink_command_long_message(self._system, 1, mav_cmd, 0, *params, *[0] * (7 - len(params))))

    def result(self, mav_cmd: int) -> int | None:
        """The newest MAV_RESULT of a command, None before the first."""
        return next((result for number, result in reversed(self.results) if number == mav_cmd), None)

    def _say(self, message: Any) -> None:
        with self._lock:
            self._socket.send(message.pack(self._codec))
            self._codec.seq = (self._codec.seq + 1) % 256

    def _run(self) -> None:
        due_s = 0.0
        while not self._ended.is_set():
            if time.monotonic() >= due_s:
                due_s = time.monotonic() + BEAT_S
                self._say(mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, 8, 0, 0, 4, 3))
            try:
                data = self._socket.recv(65_536)
            except (TimeoutError, ConnectionRefusedError):
                continue
            with self._lock:
                messages = self._codec.parse_buffer(data) or ()
            for message in messages:
                self.latest[message.get_type()] = message
                if message.get_type() == "COMMAND_ACK" and message.target_system in (0, 255):
                    self.results.append((message.command, message.result))
