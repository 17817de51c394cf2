"""Sends numbered datagrams at a steady rate, and says what came of them; runs at both ends of a link.

    link_probe.py send HOST COUNT RATE_HZ SIZE      datagrams whose IP packets have SIZE bytes; RATE_HZ 0: all at once
    link_probe.py receive SILENCE_S                 until nothing comes for SILENCE_S; then prints one row a datagram

A row is `number sent_ns received_ns sound`: the clocks are one, the host's monotonic. `sound` is 0 where a bit is
wrong; number and times mean nothing then. Datagrams go without a UDP checksum, as IPv4 allows, or the kernel would
drop those.
"""

from __future__ import annotations

import select
import socket
import struct
import sys
import time
import zlib

PORT = 9000
HEADERS = 28
_HEAD = struct.Struct(">IQI")
SO_NO_CHECK = 11
SO_RCVBUFFORCE = 33
FIRST_TIMEOUT_S = 30.0


def send(host: str, count: int, rate_hz: float, size: int) -> None:
    """In bursts of a millisecond's worth where the rate is higher than 1000 a second."""
    out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    out.setsockopt(socket.SOL_SOCKET, SO_NO_CHECK, 1)
    out.connect((host, PORT))
    padding = bytes(size - HEADERS - _HEAD.size)
    begin_ns = time.monotonic_ns()
    for number in range(count):
        due_ns = begin_ns + int(number / rate_hz * 1e9) if rate_hz else begin_ns
        while (left_ns := due_ns - time.monotonic_ns()) > 0:
            time.sleep(left_ns / 1e9 if rate_hz <= 1000 else 0.001)
        sent_ns = time.monotonic_ns()
        out.send(_HEAD.pack(number, sent_ns, check(number, sent_ns)) + padding)


def check(number: int, sent_ns: int) -> int:
    """What tells a datagram that was changed on its way."""
    return zlib.crc32(struct.pack(">IQ", number, sent_ns))


def receive(silence_s: float) -> None:
    """Prints `listening` first."""
    come = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    come.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, 64 << 20)
    come.bind(("0.0.0.0", PORT))
    print("listening", flush=True)
    rows: list[str] = []
    while select.select([come], [], [], silence_s if rows else max(silence_s, FIRST_TIMEOUT_S))[0]:
        data = come.recv(65536)
        received_ns = time.monotonic_ns()
        number, sent_ns, told = _HEAD.unpack_from(data)
        sound = told == check(number, sent_ns) and not any(data[_HEAD.size :])
        rows.append(f"{number} {sent_ns} {received_ns} {int(sound)}\n")
    print("".join(rows), end="", flush=True)


if __name__ == "__main__":
    if sys.argv[1] == "send":
        send(sys.argv[2], int(sys.argv[3]), float(sys.argv[4]), int(sys.argv[5]))
    else:
        receive(float(sys.argv[2]))
