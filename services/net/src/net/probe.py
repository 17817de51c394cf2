"""`net probe`: sends and receives datagrams on a node by a schedule, to measure the links of an idle network.

The schedule is JSON, as the only argument or on stdin. Each node gets its own flows; all nodes have the same start:

    {"run": 7, "begin_ns": 1790000000000000000, "end_s": 5.2,
     "flows": [{"flow": 1, "to": "198.18.1.3", "at_s": 0.1, "burst": 1, "every_s": 0.025, "count": 40,
                "bytes": 100, "timed": true}]}

`begin_ns` is by the system's clock, which all containers of a host share. A flow sends `burst` datagrams at once at
`at_s`, then one every `every_s`; `bytes` is the whole Ethernet frame. The output has what was sent and what arrived:

    {"late_ms": 0, "overflowed": 0, "sent": {"1": 40}, "arrived": {"2": {"count": 1, "rows": [[0, 100012, 5100200]]}}}

A row is a datagram's number, when it was sent and when the kernel received it, in nanoseconds since the start;
datagrams that are not `timed` are only counted. If `late_ms` is above zero, the probe began too late and sent nothing.
`overflowed` counts the datagrams that the kernel dropped because this program did not read them in time.
"""

from __future__ import annotations

import gc
import heapq
import json
import select
import socket
import struct
import sys
import time
from dataclasses import dataclass, field
from typing import Any

PORT = 19_799
HEAD = struct.Struct(">IHHIQ")
"""Run, flow, whether timed, number, send time."""
SMALLEST_FRAME = 14 + 20 + 8 + HEAD.size
LARGEST_FRAME = 1_514
BUFFER_BYTES = 8 << 20
BATCH = 64
"""Datagrams sent before received ones are read."""
SO_TIMESTAMPNS = 35
SO_RXQ_OVFL = 40
_STAMP = struct.Struct("@ll")
_COUNT = struct.Struct("@I")
_ROOM = socket.CMSG_SPACE(_STAMP.size) + socket.CMSG_SPACE(_COUNT.size)
_NS = 1_000_000_000
_KINDS = {"flow": (int,), "to": (str,), "at_s": (int, float), "burst": (int,), "every_s": (int, float)}
_KINDS |= {"count": (int,), "bytes": (int,), "timed": (bool,)}


class ProbeError(Exception):
    """The fault in one line; `exit_code` is 2 for a wrong schedule."""

    def __init__(self, text: str, exit_code: int = 1) -> None:
        super().__init__(text)
        self.exit_code = exit_code


@dataclass(frozen=True)
class Flow:
    """Datagrams to one neighbour; `bytes` is the whole frame's size."""

    flow: int
    to: str
    at_s: float
    burst: int
    every_s: float
    count: int
    bytes: int
    timed: bool

    def due_ns(self, number: int) -> int:
        """When a datagram is due, in ns since the start."""
        return int((self.at_s + max(0, number - self.burst + 1) * self.every_s) * _NS)


@dataclass(frozen=True)
class Schedule:
    """The flows that one node sends, and until when it receives."""

    run: int
    begin_ns: int
    end_s: float
    flows: tuple[Flow, ...]


@dataclass
class ArrivedDatagrams:
    """The datagrams that arrived of one flow."""

    count: int = 0
    rows: list[tuple[int, int, int]] = field(default_factory=list)


def parse_schedule(text: str) -> Schedule:
    """Parse a schedule. Raises ProbeError that names the field, its value and what was expected."""
    try:
        found = json.loads(text)
    except ValueError as error:
        raise ProbeError(f"schedule: not JSON: {error}", 2) from error
    if not isinstance(found, dict):
        raise ProbeError("schedule: expected an object", 2)
    for name, kinds in {"run": (int,), "begin_ns": (int,), "end_s": (int, float), "flows": (list,)}.items():
        _check(found, name, kinds, "schedule")
    flows = tuple(_flow(each, f"schedule: flows[{place}]") for place, each in enumerate(found["flows"]))
    return Schedule(found["run"], found["begin_ns"], found["end_s"], flows)


def _flow(found: Any, where: str) -> Flow:
    if not isinstance(found, dict):
        raise ProbeError(f"{where}: expected an object", 2)
    for name, kinds in _KINDS.items():
        _check(found, name, kinds, where)
    if not SMALLEST_FRAME <= found["bytes"] <= LARGEST_FRAME:
        expected = f"from {SMALLEST_FRAME} to {LARGEST_FRAME}"
        raise ProbeError(f"{where}.bytes: {found['bytes']}: expected {expected}", 2)
    try:
        socket.inet_aton(found["to"])
    except OSError as error:
        raise ProbeError(f"{where}.to: {found['to']!r}: expected an IPv4 address", 2) from error
    return Flow(**{name: found[name] for name in _KINDS})


def _check(found: dict[str, Any], name: str, kinds: tuple[type, ...], where: str) -> None:
    value = found.get(name)
    if not isinstance(value, kinds) or (isinstance(value, bool) and bool not in kinds):
        raise ProbeError(f"{where}.{name}: {value!r}: expected {' or '.join(kind.__name__ for kind in kinds)}", 2)
    if isinstance(value, (int, float)) and value < 0:
        raise ProbeError(f"{where}.{name}: {value!r}: expected no less than 0", 2)


class Probe:
    """One socket that sends and receives; `run` lasts until the schedule's end."""

    def __init__(self, schedule: Schedule, port: int = PORT, address: str = "0.0.0.0") -> None:
        self._schedule = schedule
        self._arrived: dict[int, ArrivedDatagrams] = {}
        self._overflowed = 0
        self._port = port
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
        self._socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        self._socket.setsockopt(socket.SOL_SOCKET, SO_RXQ_OVFL, 1)
        try:
            self._socket.bind((address, port))
        except OSError as error:
            raise ProbeError(f"UDP port {port}: {error.strerror}; expected no other probe on this node") from error

    def run(self) -> dict[str, Any]:
        """Carry out the schedule; returns the content of the output: what was sent and what arrived."""
        schedule = self._schedule
        late_ns = time.time_ns() - schedule.begin_ns
        if late_ns > 0:
            return {"late_ms": late_ns / 1e6, "overflowed": 0, "sent": {}, "arrived": {}}
        gc.disable()
        end_ns = schedule.begin_ns + int(schedule.end_s * _NS)
        sent = [0] * len(schedule.flows)
        due = [(schedule.begin_ns + flow.due_ns(0), place) for place, flow in enumerate(schedule.flows) if flow.count]
        heapq.heapify(due)
        while (now_ns := time.time_ns()) < end_ns:
            if due and due[0][0] <= now_ns:
                self._send_due(due, sent)
            self._receive()
            left_ns = min(end_ns, due[0][0] if due else end_ns) - time.time_ns()
            if left_ns > 0:
                select.select([self._socket], [], [], left_ns / _NS)
        self._receive()
        flows = {
            str(flow): {"count": arrived.count, "rows": arrived.rows} for flow, arrived in sorted(self._arrived.items())
        }
        counts = {str(flow.flow): count for flow, count in zip(schedule.flows, sent, strict=True)}
        return {"late_ms": 0, "overflowed": self._overflowed, "sent": counts, "arrived": flows}

    def close(self) -> None:
        self._socket.close()

    def _send_due(self, due: list[tuple[int, int]], sent: list[int]) -> None:
        run, begin_ns = self._schedule.run, self._schedule.begin_ns
        for _ in range(BATCH):
            if not due or due[0][0] > time.time_ns():
                return
            _, place = due[0]
            flow, number = self._schedule.flows[place], sent[place]
            padding = bytes(flow.bytes - SMALLEST_FRAME)
            head = HEAD.pack(run, flow.flow, flow.timed, number, time.time_ns())
            try:
                self._socket.sendto(head + padding, (flow.to, self._port))
            except OSError as error:
                raise ProbeError(f"a datagram to {flow.to}: {error.strerror}; expected a way there") from error
            sent[place] = number + 1
            if number + 1 == flow.count:
                heapq.heappop(due)
            else:
                heapq.heapreplace(due, (begin_ns + flow.due_ns(number + 1), place))

    def _receive(self) -> None:
        """Read all received datagrams; those of another run, which came late, are ignored."""
        begin_ns, run = self._schedule.begin_ns, self._schedule.run
        while True:
            try:
                data, told, _, _ = self._socket.recvmsg(HEAD.size, _ROOM, socket.MSG_DONTWAIT)
            except BlockingIOError:
                return
            received_ns = 0
            for _, kind, value in told:
                if kind == SO_TIMESTAMPNS:
                    seconds, nanoseconds = _STAMP.unpack(value)
                    received_ns = seconds * _NS + nanoseconds
                elif kind == SO_RXQ_OVFL:
                    self._overflowed = _COUNT.unpack(value)[0]
            if len(data) < HEAD.size:
                continue
            its_run, flow, timed, number, sent_ns = HEAD.unpack(data)
            if its_run != run:
                continue
            arrived = self._arrived.setdefault(flow, ArrivedDatagrams())
            arrived.count += 1
            if timed:
                arrived.rows.append((number, sent_ns - begin_ns, received_ns - begin_ns))


def probe(text: str) -> str:
    """Carry out a schedule; returns the output in JSON. Raises ProbeError."""
    made = Probe(parse_schedule(text))
    try:
        return json.dumps(made.run(), separators=(",", ":"))
    finally:
        made.close()


def main(words: list[str]) -> int:
    """Run the command; exit code 2 for a wrong schedule, 1 if it cannot be carried out."""
    if len(words) > 1:
        print("net probe: expected one schedule, as JSON", file=sys.stderr)
        return 2
    try:
        print(probe(words[0] if words else sys.stdin.read()), flush=True)
    except ProbeError as error:
        print(f"net probe: {error}", file=sys.stderr)
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
