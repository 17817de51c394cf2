#!/usr/bin/python3
"""The first process of the virtual machine: it runs the nodes, a shaper, and datagrams over the shaper's links.

Reads /job.json, {"nodes": {NAME: [net's address, the node's]}, "links": [[NODE, NODE]…], "shaper": "netem" | "nfqueue",
"rounds": [{"plan", "kernel", "flows"}…]}, and writes the rounds' results as JSON to the machine's second console.

Every node is a network namespace with a cable to this one, which is `net`. A flow is {"source", "destination", "size",
"count", "every_us", "start_us"}: `count` datagrams, `every_us` apart, whose IP packets have `size` bytes. Its result is
the number sent and a row for each datagram that arrived: number, times of sending and arrival in us since the round
began, and whether all its bits are intact.
"""

from __future__ import annotations

import ctypes
import gc
import heapq
import json
import os
import select
import signal
import socket
import struct
import subprocess
import sys
import time
import traceback
import zlib
from pathlib import Path
from typing import Any

FIRST_PORT = 9000
HEADERS = 28
MARK = 0x5EED
_HEAD = struct.Struct(">IQI")
SO_NO_CHECK = 11
SO_RCVBUFFORCE = 33
SO_TIMESTAMPNS = 35
INIT_MODULE = 175
LIBC = ctypes.CDLL(None, use_errno=True)
SILENCE_NS = 1_500_000_000
READY_TIMEOUT_S = 60.0
RESULTS = "/dev/vport0p1"
FAILED = 255
COUNT_EVERY_S = 1000.0
"""netem's driver starts a process to count, which takes long in the machine; it counts at the end as well."""


def main() -> None:
    """Do the job in a process of its own, whose errors are printed to the console, and switch the machine off."""
    for kind, place in (
        ("proc", "/proc"),
        ("sysfs", "/sys"),
        ("devtmpfs", "/dev"),
        ("tmpfs", "/run"),
        ("tmpfs", "/tmp"),
    ):
        LIBC.mount(kind.encode(), place.encode(), kind.encode(), 0, None)
    os.environ.update(PATH="/usr/sbin:/usr/bin", PYTHONDONTWRITEBYTECODE="1")
    sys.path.insert(0, "/job")
    worker = os.fork()
    if not worker:
        work()
        sys.exit()
    os.waitpid(worker, 0)
    Path("/proc/sysrq-trigger").write_text("o")
    while True:
        time.sleep(1)


def work() -> None:
    for module in sorted(Path("/modules").iterdir()):
        content = module.read_bytes()
        if LIBC.syscall(INIT_MODULE, content, len(content), b""):
            raise OSError(ctypes.get_errno(), f"{module.name}: {os.strerror(ctypes.get_errno())}")
    job = json.loads(Path("/job/job.json").read_text())
    versions = {"kernel": os.uname().release, "tc": output(["tc", "-V"]).strip()}
    text = json.dumps({**versions, "rounds": run(job)}).encode() + b"\n"
    with open(RESULTS, "wb", buffering=0) as out:
        while text:
            text = text[out.write(text) :]


def output(command: list[str], text: str | None = None) -> str:
    done = subprocess.run(command, input=text, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)}: {done.stderr or done.stdout}\n{text or ''}")
    return done.stdout


def run(job: dict[str, Any]) -> list[dict[str, Any]]:
    nodes = Nodes(job["nodes"], job["links"])
    shaper: Shaper = (Netem if job["shaper"] == "netem" else Nfqueue)(nodes)
    found = []
    for each in job["rounds"]:
        began_s = time.monotonic()
        shaper.begin(each["plan"], each["kernel"])
        rows = Flows(nodes, each["flows"]).run()
        counters = shaper.end()
        came = sum(len(flow["rows"]) for flow in rows)
        print(f"round {each['name']}: {came} datagrams, {time.monotonic() - began_s:.1f} s", flush=True)
        found.append({"flows": rows, "counters": counters})
    return found


class Nodes:
    """Namespaces with cables to this one; `socket` makes a socket in one."""

    def __init__(self, nodes: dict[str, list[str]], links: list[list[str]]) -> None:
        from net.hops import route_by_hops
        from net.interfaces import OFFLOADS, Cable, find_ports, turn_off_offloads

        self.addresses = {name: node for name, (_, node) in nodes.items()}
        self.pairs = tuple((one, other) for one, other in links)
        lines = ["link set lo up"]
        for number, (name, (net, node)) in enumerate(nodes.items()):
            mac = [f"02:00:00:00:{number:02x}:{end:02x}" for end in (2, 3)]
            lines += [
                f"netns add {name}",
                f"link add to-{name} address {mac[0]} type veth peer name eth0 address {mac[1]} netns {name}",
                f"address add {net}/24 dev to-{name}", f"link set to-{name} up",
                f"neigh replace {node} lladdr {mac[1]} dev to-{name} nud permanent",
            ]  # fmt: skip
        Path("/proc/sys/net/ipv6/conf/default/disable_ipv6").write_text("1")
        Path("/proc/sys/net/ipv4/ip_forward").write_text("1")
        output(["ip", "-batch", "-"], "\n".join(lines) + "\n")
        offloads = [word for offload in OFFLOADS for word in (offload, "off")]
        for number, (name, (net, node)) in enumerate(nodes.items()):
            lines = [
                "link set lo up", f"address add {node}/24 dev eth0", "link set eth0 up", f"route add default via {net}",
                f"neigh replace {net} lladdr 02:00:00:00:{number:02x}:02 dev eth0 nud permanent",
            ]  # fmt: skip
            output(["ip", "-netns", name, "-batch", "-"], "\n".join(lines) + "\n")
            output(["ip", "netns", "exec", name, "ethtool", "-K", "eth0", *offloads])
        self.ports = find_ports({name: Cable(*pair) for name, pair in nodes.items()}, output(["ip", "-json", "addr"]))
        for port in self.ports:
            turn_off_offloads(port)
        route_by_hops(self.ports, self.pairs)
        self._here = os.open("/proc/self/ns/net", os.O_RDONLY)

    def socket(self, name: str) -> socket.socket:
        """A UDP socket in a node's namespace."""
        there = os.open(f"/run/netns/{name}", os.O_RDONLY)
        os.setns(there, os.CLONE_NEWNET)
        os.close(there)
        try:
            return socket.socket(socket.AF_INET, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        finally:
            os.setns(self._here, os.CLONE_NEWNET)


class Flows:
    """Sends and receives all datagrams of a round."""

    def __init__(self, nodes: Nodes, flows: list[dict[str, Any]]) -> None:
        self._flows = flows
        self._rows: list[list[tuple[int, int, int, int]]] = [[] for _ in flows]
        self._out, self._in, self._padding = [], {}, []
        self._poll = select.epoll()
        for number, flow in enumerate(flows):
            come = nodes.socket(flow["destination"])
            come.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, 8 << 20)
            come.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
            come.bind((nodes.addresses[flow["destination"]], FIRST_PORT + number))
            out = nodes.socket(flow["source"])
            out.setsockopt(socket.SOL_SOCKET, SO_NO_CHECK, 1)
            out.connect((nodes.addresses[flow["destination"]], FIRST_PORT + number))
            self._out.append(out)
            self._padding.append(bytes(flow["size"] - HEADERS - _HEAD.size))
            self._in[come.fileno()] = (number, come)
            self._poll.register(come.fileno(), select.EPOLLIN)

    def run(self) -> list[dict[str, Any]]:
        gc.disable()
        clock, flows = time.monotonic_ns, self._flows
        zero_ns = clock() + 1_000_000
        wall_ns = time.time_ns() - clock() + zero_ns
        ahead = [(zero_ns + flow["start_us"] * 1000, number, 0) for number, flow in enumerate(flows) if flow["count"]]
        heapq.heapify(ahead)
        last_ns = clock()
        while True:
            now_ns = clock()
            while ahead and ahead[0][0] <= now_ns:
                due_ns, number, index = ahead[0]
                flow = flows[number]
                if index + 1 < flow["count"]:
                    heapq.heapreplace(ahead, (due_ns + flow["every_us"] * 1000, number, index + 1))
                else:
                    heapq.heappop(ahead)
                now_ns = last_ns = clock()
                stamp = now_ns - zero_ns
                told = zlib.crc32(struct.pack(">IIQ", number, index, stamp))
                self._out[number].send(_HEAD.pack(index, stamp, told) + self._padding[number])
            next_ns = ahead[0][0] if ahead else last_ns + SILENCE_NS
            left_ns = next_ns - clock()
            if left_ns <= 0:
                if not ahead:
                    break
                continue
            for descriptor, _ in self._poll.poll(left_ns / 1e9):
                last_ns = clock()
                self._take(descriptor, wall_ns)
        for _, come in self._in.values():
            come.close()
        for out in self._out:
            out.close()
        self._poll.close()
        return [{"sent": flow["count"], "rows": rows} for flow, rows in zip(flows, self._rows, strict=True)]

    def _take(self, descriptor: int, wall_ns: int) -> None:
        number, come = self._in[descriptor]
        try:
            data, extra, _, _ = come.recvmsg(65536, 64)
        except BlockingIOError:  # a flipped bit gave it a checksum, which is wrong
            return
        seconds, nanoseconds = struct.unpack("=qq", extra[0][2])
        came_ns = seconds * 1_000_000_000 + nanoseconds - wall_ns
        index, stamp, told = _HEAD.unpack_from(data)
        sound = told == zlib.crc32(struct.pack(">IIQ", number, index, stamp)) and not any(data[_HEAD.size :])
        self._rows[number].append(
            (index, stamp // 1000, came_ns // 1000, int(sound)) if sound else (-1, 0, came_ns // 1000, 0)
        )


class Shaper:
    """A shaper in a process of its own, with priority over all others; `end` returns its counters."""

    def __init__(self, nodes: Nodes) -> None:
        self._nodes = nodes
        self._folder = Path("/tmp/shaping")
        self._folder.mkdir()

    def begin(self, plan: Any, kernel: Any) -> None:
        ready = self._folder / "ready"
        ready.unlink(missing_ok=True)
        pid = os.fork()
        if not pid:
            code = FAILED
            try:
                os.setpriority(os.PRIO_PROCESS, 0, -20)
                self.shape(plan, kernel, ready)
                code = 0
            except Exception:
                traceback.print_exc()
                raise
            finally:
                os._exit(code)
        self._pid = pid
        deadline_s = time.monotonic() + READY_TIMEOUT_S
        while not ready.exists():
            if time.monotonic() > deadline_s or os.waitpid(pid, os.WNOHANG)[0]:
                raise RuntimeError("the shaper does not start; see the console")
            time.sleep(0.01)

    def shape(self, plan: Any, kernel: Any, ready: Path) -> None:
        raise NotImplementedError

    def end(self) -> dict[str, Any]:
        os.kill(self._pid, signal.SIGTERM)
        _, status = os.waitpid(self._pid, 0)
        if status:
            raise RuntimeError(f"the shaper ended with {status}; see the console")
        counters: dict[str, Any] = json.loads((self._folder / "counters.json").read_text())
        return counters


class Netem(Shaper):
    """Carries out the plan's commands, reads the links back, and changes them at the events' times."""

    def shape(self, plan: Any, kernel: Any, ready: Path) -> None:
        from net.emulator.plan import parse_plan
        from net.ending import Ending
        from net.shaping import kernel as driver
        from net.shaping.journal import Journal
        from net.shaping.run_plan import RunPlan

        driver.COUNT_EVERY_S = COUNT_EVERY_S
        with Ending() as ending:
            run = RunPlan("netem", False, parse_plan(plan, "job"), kernel, ())
            links = driver.KernelLinks(self._folder, run, self._nodes.ports, Journal(self._folder / "events.jsonl"))
            print(f"read back: {links.checked}", flush=True)
            links.start(time.time_ns())
            ready.touch()
            while not ending.has_come():
                select.select([ending.wake], (), (), links.attend())
            links.end()


class Nfqueue(Shaper):
    """The emulator."""

    def shape(self, plan: Any, kernel: Any, ready: Path) -> None:
        from net.emulator.plan import parse_plan
        from net.emulator.process import shape

        shape(parse_plan(plan, "job"), self._nodes.ports, self._nodes.pairs, self._folder / "counters.json", ready)


main()
