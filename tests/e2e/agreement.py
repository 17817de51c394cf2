"""The packets table of a flown attempt, held to programs that share no line with it: tshark and pymavlink's parser."""

from __future__ import annotations

import ipaddress
import subprocess
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import polars as pl
from pymavlink.dialects.v20 import development
from scapy.utils import RawPcapReader

from testbed.fly.results import Attempt
from testbed.numbers.packets.mavlink import name_of
from testbed.numbers.packets.table import load

_FIELDS = ("frame.len", "eth.src", "ip.src", "ip.dst", "mqtt.msgtype")
_CUT_SHORT = 2
"""tshark's exit code for a file that ends within a frame; what is before it is printed all the same."""
_PUBLISH = "3"
_ETHERNET, _UDP_HEADER, _UDP = 14, 8, 17


@dataclass
class Counted:
    """What tshark found in one capture: all frames, and of those that a node sent to another, bytes and PUBLISHes."""

    frames: int = 0
    entered: int = 0
    entered_bytes: int = 0
    publishes: int = 0


@dataclass(frozen=True)
class Nodes:
    """How to tell, by a capture's own frames alone, which of them came from its node and are for another."""

    address: dict[str, str]
    mac: dict[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, attempt: Attempt) -> Nodes:
        macs = {str(capture["node"]): str(capture["mac"]) for capture in attempt.captures() if "mac" in capture}
        return cls({node.name: node.address for node in attempt.topology().nodes}, macs)

    def entered(self, capture: str, source_mac: str, source: str, destination: str) -> bool:
        """Whether a frame came from the node of a capture; `net` has sent the others to it."""
        known = self.address.values()
        if source not in known or destination not in known:
            return False
        if capture in self.mac:
            return source_mac.lower() != self.mac[capture].lower()
        return source == self.address[capture]


def assert_tshark_agrees(attempt: Attempt) -> None:
    """tshark counts the frames, bytes and MQTT PUBLISHes that the table has, capture by capture."""
    packets = load(attempt)
    nodes = Nodes.of(attempt)
    paths = sorted((attempt.path / "pcap").glob("*.pcap"))
    assert paths, f"{attempt.path}: no captures"
    publishes = _publishes_by_node(packets.frames, packets.messages)
    frames = 0
    for path in paths:
        told = count_by_tshark(path, nodes, path.name in packets.truncated, attempt.key_log)
        own = packets.frames.filter(pl.col("node").cast(pl.String) == path.stem)
        found = (len(own), own["size"].sum(), publishes[path.stem])
        assert found == (told.entered, told.entered_bytes, told.publishes), (
            f"{path.name}: frames, bytes and PUBLISHes are {found} in the table, "
            f"{(told.entered, told.entered_bytes, told.publishes)} by tshark"
        )
        frames += told.frames
    left = packets.frames["left_ns"].is_not_null().sum() + packets.unmatched
    assert len(packets.frames) + left + len(packets.strays) == frames, "a frame of the captures is nowhere in the table"


def _publishes_by_node(frames: pl.DataFrame, messages: pl.DataFrame) -> Counter[str]:
    sent = messages.filter(pl.col("kind").cast(pl.String) == "publish")["frame"]
    return Counter(frames["node"].gather(sent).cast(pl.String).to_list())


def count_by_tshark(path: Path, nodes: Nodes, truncated: bool = False, key_log: Path | None = None) -> Counted:
    """Frames by tshark's own reading of a capture, PUBLISHes by its MQTT dissector with its TCP reassembly.

    What is in TLS it decrypts with the keys of `key_log`.
    """
    options = [word for name in _FIELDS for word in ("-e", name)]
    options += ["-o", f"tls.keylog_file:{key_log}"] if key_log is not None and key_log.exists() else []
    done = subprocess.run(
        ["tshark", "-n", "-r", str(path), "-T", "fields", "-E", "separator=/t", "-E", "occurrence=a", *options],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode in ((0, _CUT_SHORT) if truncated else (0,)), done.stderr
    found = Counted()
    for line in done.stdout.splitlines():
        size, source_mac, source, destination, kinds = line.split("\t")
        found.frames += 1
        ends = source.split(",")[0], destination.split(",")[0]  # an ICMP error repeats the header that it is about
        if nodes.entered(path.stem, source_mac, *ends):
            found.entered += 1
            found.entered_bytes += int(size)
            found.publishes += kinds.split(",").count(_PUBLISH)
    return found


def assert_pymavlink_agrees(attempt: Attempt) -> None:
    """pymavlink's parser finds the messages that the table has: as many of each name, and as many bytes."""
    packets = load(attempt)
    nodes = Nodes.of(attempt)
    node = packets.frames["node"].cast(pl.String).gather(packets.messages["frame"])
    table = (
        packets.messages.with_columns(node.alias("node"))
        .filter(pl.col("protocol").cast(pl.String) == "mavlink")
        .group_by("node", pl.col("kind").cast(pl.String))
        .agg(pl.len().alias("count"), pl.col("bytes").sum())
    )
    own = {(row["node"], row["kind"]): (row["count"], row["bytes"]) for row in table.iter_rows(named=True)}
    told: dict[tuple[str, str], tuple[int, int]] = defaultdict(lambda: (0, 0))
    for path in sorted((attempt.path / "pcap").glob("*.pcap")):
        parser = development.MAVLink(None)
        for datagram in _datagrams(path, nodes):
            if datagram[:1] not in (b"\xfd", b"\xfe"):
                continue
            for message in parser.parse_buffer(datagram) or ():
                kind = kind_of(message)
                count, size = told[path.stem, kind]
                told[path.stem, kind] = count + 1, size + len(message.get_msgbuf())
            assert parser.buf_len() == 0, f"{path.name}: a datagram ends within a message"
    different = {
        key: (own.get(key), told.get(key)) for key in own.keys() | told.keys() if own.get(key) != told.get(key)
    }
    assert not different, f"(capture, message): (messages, bytes) in the table and by pymavlink: {different}"


def kind_of(message: Any) -> str:
    """The table's name of a message; to one that it does not know, pymavlink gives its number."""
    name = str(message.get_type())
    return name_of(int(name.removeprefix("UNKNOWN_"))) if name.startswith("UNKNOWN_") else name


def _datagrams(path: Path, nodes: Nodes) -> Iterator[bytes]:
    """What UDP carries in the frames that came from the capture's node."""
    with RawPcapReader(str(path)) as reader:
        for data, meta in reader:
            if len(data) < meta.caplen or data[12:14] != b"\x08\x00" or data[_ETHERNET + 9] != _UDP:
                continue
            source, destination = (str(ipaddress.IPv4Address(data[at : at + 4])) for at in (26, 30))
            if nodes.entered(path.stem, data[6:12].hex(":"), source, destination):
                start = _ETHERNET + 4 * (data[_ETHERNET] & 15)
                end = start + int.from_bytes(data[start + 4 : start + 6], "big")
                yield data[start + _UDP_HEADER : end]
