"""Sends a recorded stream again, frame for frame, and tells what came of it; runs on a node, with Python alone.

fit_sender.py send FILE HOST BEGIN_NS     FILE has [[t_ns, size], …] in JSON; BEGIN_NS of the monotonic clock is 0
fit_sender.py receive SILENCE_S           until nothing comes for SILENCE_S; then prints the numbers by sender
"""

from __future__ import annotations

import json
import select
import socket
import struct
import sys
import time
from pathlib import Path

PORT = 9000
HEADERS = 14 + 20 + 8
SO_RCVBUFFORCE = 33
FIRST_TIMEOUT_S = 30.0
_NUMBER = struct.Struct(">I")


def send(file: Path, host: str, begin_ns: int) -> None:
    """Frames that are due at once go at once; each is its number and zeros. Prints how late the latest was, in ms."""
    out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    out.connect((host, PORT))
    latest_ns = 0
    for number, (t_ns, size) in enumerate(json.loads(file.read_text())):
        due_ns = begin_ns + t_ns
        while (left_ns := due_ns - time.monotonic_ns()) > 0:
            time.sleep(left_ns / 1e9)
        latest_ns = max(latest_ns, -left_ns)
        out.send(_NUMBER.pack(number) + bytes(size - HEADERS - _NUMBER.size))
    print(latest_ns // 1_000_000)


def receive(silence_s: float) -> None:
    """Prints `listening` first."""
    come = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    come.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, 64 << 20)
    come.bind(("0.0.0.0", PORT))
    print("listening", flush=True)
    found: dict[str, list[int]] = {}
    while select.select([come], [], [], silence_s if found else FIRST_TIMEOUT_S)[0]:
        data, (host, _) = come.recvfrom(2048)
        found.setdefault(host, []).append(_NUMBER.unpack_from(data)[0])
    print(json.dumps(found))


if __name__ == "__main__":
    if sys.argv[1] == "send":
        send(Path(sys.argv[2]), sys.argv[3], int(sys.argv[4]))
    else:
        receive(float(sys.argv[2]))
