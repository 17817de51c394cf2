"""Replays a recorded stream, frame by frame, and reports its arrivals; runs on a node, with Python alone.

fit_sender.py send FILE HOST BEGIN_NS     FILE has [[t_ns, size], …] in JSON; BEGIN_NS of the monotonic clock is 0
fit_sender.py receive SILENCE_S           until nothing arrives for SILENCE_S; then prints the numbers by sender
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import socket
import struct
import sys
import time
from pathlib import Path

NICE = -10
PORT = 9000
HEADERS = 14 + 20 + 8
SO_RCVBUFFORCE = 33
FIRST_TIMEOUT_S = 30.0
_NUMBER = struct.Struct(">I")


def send(file: Path, host: str, begin_ns: int) -> None:
    """Send frames, those due together at once; each is its number and zeros. Prints their times, as in the file."""
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, NICE)
    out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sent_ns = []
    for number, (t_ns, size) in enumerate(json.loads(file.read_text())):
        due_ns = begin_ns + t_ns
        while (left_ns := due_ns - time.monotonic_ns()) > 0:
            time.sleep(left_ns / 1e9)
        sent_ns.append(time.monotonic_ns() - begin_ns)
        out.sendto(_NUMBER.pack(number) + bytes(size - HEADERS - _NUMBER.size), (host, PORT))
    print(json.dumps(sent_ns))


def receive(silence_s: float) -> None:
    """Print `listening`, receive, and print the numbers by sender."""
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
