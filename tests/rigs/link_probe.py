"""Sends numbered datagrams at a steady rate and reports their arrivals; runs at both ends of a link.

    link_probe.py send HOST COUNT RATE_HZ SIZE      datagrams whose IP packets have SIZE bytes; RATE_HZ 0: all at once
    link_probe.py receive SILENCE_S                 until nothing arrives for SILENCE_S; then prints a row per datagram

A row is `number sent_ns received_ns sound`; both times are of the host's monotonic clock. `sound` is 0 if a bit is
wrong; number and times mean nothing then. Datagrams are sent without a UDP checksum, as IPv4 allows; else the kernel
would drop the damaged ones.
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
    """Send `count` datagrams; above 1000 per second, in bursts of a millisecond's worth."""
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
    """The checksum by which a changed datagram is recognized."""
    return zlib.crc32(struct.pack(">IQ", number, sent_ns))


def receive(silence_s: float) -> None:
    """Print `listening`, receive, and print the rows."""
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
