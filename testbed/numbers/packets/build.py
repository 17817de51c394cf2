"""Makes the packets table from captures: assigns frames to links, matches both ends, and reads the messages."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
import polars as pl

from ...errors import ResultsError
from ...fly.pcap import CapturedFrames, Flags, Ints, Words, empty_capture, read_capture
from ...fly.results import Attempt
from . import purposes
from .headers import MAVLINK, MQTT, MQTT_PORT, MQTT_SN, MQTTS_PORT, UDP, Headers, read_headers
from .links import NOWHERE, Tree, match
from .mavlink import MessageColumns, find_messages
from .mqtt import VERSION_5, Direction, randoms_of, read_direction, read_tls_direction
from .mqttsn import Datagram, read_datagrams
from .rows import MESSAGE_SCHEMA, Columns, frame_rows, mavlink_rows, mqtt_rows, stray_rows
from .streams import SYN, Segment
from .tcp import NEEDED, NEEDLESS, retransmissions
from .tls import Secrets, read_key_log

_FROM_HEADERS = ("protocol", "source_port", "destination_port", "ethernet", "ip", "transport", "sequence", "flags")
APART_NS = 100_000_000
"""By how much a capture may end before another, although all are told to at once."""
_OPENS_OR_ENDS = 0x07
"""TCP's FIN, SYN and RST."""


@dataclass(frozen=True)
class Built:
    """The tables before strays are split off: `rows` are frames on links, sorted by time, then those on none.

    `unread` counts the TLS flows that the attempt's key log does not open to their ends.
    """

    rows: pl.DataFrame
    messages: pl.DataFrame
    truncated: tuple[str, ...]
    unmatched: int
    duplicates: int
    until_ns: dict[str, int]
    unread: int


@dataclass(frozen=True)
class _CaptureFrames:
    """The frames of one capture: those that entered a link there, with their messages; those that left one; strays.

    `mavlink.datagram` and the keys of `bodies` (the content of MQTT and MQTT-SN frames) are indexes into `entered`.
    """

    entered: Columns
    mavlink: MessageColumns
    bodies: dict[int, bytes]
    left: Columns
    strays: Columns


def build(attempt: Attempt) -> Built:
    """Make the table from an attempt's captures. Raises ResultsError for a file that is no capture."""
    tree = Tree(attempt.topology())
    macs = _macs(attempt)
    parts: list[_CaptureFrames] = []
    nodes: list[str] = []
    truncated: list[str] = []
    last_ns: dict[str, int] = {}
    for path in sorted((attempt.path / "pcap").glob("*.pcap")):
        capture = read_capture(path)
        parts.append(_read_part(tree, path.stem, len(nodes), capture, macs.get(path.stem)))
        nodes.append(path.stem)
        last_ns[path.stem] = int(capture.t_ns.max(initial=0))
        truncated += [path.name] if capture.truncated else []
    parts = parts or [_read_part(tree, "", 0, empty_capture(), None)]

    counts = [len(part.entered["t_ns"]) for part in parts]
    entered, order = _in_order(_joined([part.entered for part in parts]))
    left, _ = _in_order(_joined([part.left for part in parts]))
    place = match(entered["key"], entered["t_ns"], left["key"], left["t_ns"])
    entered["left_ns"] = np.append(left["t_ns"], NOWHERE)[place]

    last_event_ns = max((int(event["t_ns"]) for event in attempt.events()), default=0)  # the network ends after it
    least_ns = max(last_event_ns, max(last_ns.values(), default=0) - APART_NS)
    until_ns = dict.fromkeys(tree.nodes, 0) | {
        node: seen_ns if f"{node}.pcap" in truncated else max(seen_ns, least_ns) for node, seen_ns in last_ns.items()
    }
    entered["lost"] = _lost(tree, entered, until_ns)

    row_of = np.empty_like(order)
    row_of[order] = np.arange(len(order))
    firsts = np.cumsum([0, *counts])
    bodies = {
        int(row_of[first + local]): body
        for first, part in zip(firsts, parts, strict=False)
        for local, body in part.bodies.items()
    }
    strays = stray_rows(nodes, _joined([part.strays for part in parts]))
    found = [part.mavlink for part in parts]
    del parts  # from here on memory holds little more than the table, and each step frees what it has used
    rows = np.concatenate([row_of[first + each.datagram] for first, each in zip(firsts, found, strict=False)])
    segments = _mqtt_segments(entered, bodies)
    directions, unread = _mqtt_directions(segments, read_key_log(attempt.key_log))
    directions.append(read_datagrams(_flows_of_datagrams(entered, bodies)))
    payload_bytes, tls_bytes = np.zeros(len(order), dtype=np.int64), np.zeros(len(order), dtype=np.int64)
    np.add.at(payload_bytes, rows, np.concatenate([each.payload_size for each in found]))
    messages = pl.concat([mavlink_rows(found, rows, entered["left_ns"]), mqtt_rows(directions)])
    del found, rows, order, row_of
    messages = messages.sort("frame", maintain_order=True)
    messages = messages.with_columns(purposes.of_messages(messages, tree.drones))
    for direction in directions:
        payload_bytes[list(direction.payload_bytes)] = list(direction.payload_bytes.values())
        tls_bytes[list(direction.tls_bytes)] = list(direction.tls_bytes.values())
    duplicates = _copies(entered["key"], left["key"])
    unmatched = len(left["t_ns"]) - int((place != NOWHERE).sum())
    del left, place
    frames = frame_rows(tree, nodes, entered, messages, payload_bytes, tls_bytes)
    frames = frames.with_columns(
        _frame_purposes(frames["purpose"], entered, directions),
        _repeats(len(frames), segments.values(), directions),
        _begins(frames["messages"], directions),
    )
    del entered
    told = frames.select(pl.col("t_ns", "link").gather(messages["frame"]))
    return Built(
        pl.concat([frames, strays]),
        messages.with_columns(told).select(MESSAGE_SCHEMA.names()),
        tuple(truncated),
        unmatched,
        duplicates,
        until_ns,
        unread,
    )


def _copies(entered: Words, left: Words) -> int:
    """The number of frames that left links as additional copies of frames that entered."""
    keys, came = np.unique(entered, return_counts=True)
    left_keys, went = np.unique(left, return_counts=True)
    place = np.minimum(np.searchsorted(keys, left_keys), max(0, len(keys) - 1))
    known = keys[place] == left_keys if len(keys) else np.zeros(len(left_keys), dtype=np.bool_)
    return int(np.maximum(0, went[known] - came[place[known]]).sum())


def _lost(tree: Tree, entered: Columns, until_ns: dict[str, int]) -> Flags:
    """Whether each frame's link lost it: it never left, though the capture at the far end went on long enough.

    Long enough is the longest time that any frame was on that link.
    """
    links, stayed = entered["link"], entered["left_ns"] == NOWHERE
    longest = np.zeros(len(tree.links), dtype=np.int64)
    np.maximum.at(longest, links[~stayed], (entered["left_ns"] - entered["t_ns"])[~stayed])
    until = np.array([until_ns[tree.receiver(name)] for name in tree.links], dtype=np.int64)
    late = entered["t_ns"] + longest[links] > until[links]
    lost: Flags = np.logical_and(stayed, ~late)
    return lost


def _macs(attempt: Attempt) -> dict[str, int]:
    """The MAC address of `net` on each port, as far as `captures.json` has it."""
    told = {str(capture["node"]): str(capture["mac"]) for capture in attempt.captures() if capture.get("mac")}
    for node, mac in told.items():
        if re.fullmatch(r"(?:[0-9a-fA-F]{2}:){5}[0-9a-fA-F]{2}", mac) is None:
            raise ResultsError(f"{attempt.path / 'pcap' / 'captures.json'}: mac of {node} is {mac}, expected six bytes")
    return {node: int(mac.replace(":", ""), 16) for node, mac in told.items()}


def _read_part(tree: Tree, node: str, number: int, capture: CapturedFrames, mac: int | None) -> _CaptureFrames:
    headers = read_headers(capture)
    link, departs = tree.place(node, headers, mac)
    went_in, came_out = np.flatnonzero((link != NOWHERE) & departs), np.flatnonzero((link != NOWHERE) & ~departs)
    off = np.flatnonzero(link == NOWHERE)
    key = headers.key ^ link.astype(np.uint64) << np.uint64(56)
    udp = np.flatnonzero(headers.protocol[went_in] == UDP)
    mavlink = find_messages(capture.data, headers.body[went_in[udp]], headers.body_end[went_in[udp]])
    mavlink = replace(mavlink, datagram=udp[mavlink.datagram])
    protocol = headers.protocol[went_in]
    protocol[mavlink.datagram] = MAVLINK
    entered = {name: getattr(headers, name)[went_in] for name in _FROM_HEADERS} | {
        "protocol": protocol,
        "body": (headers.body_end - headers.body)[went_in],
        "t_ns": capture.t_ns[went_in],
        "size": capture.sizes[went_in],
        "offset": capture.starts[went_in],
        "link": link[went_in],
        "key": key[went_in],
        "node": np.full(len(went_in), number),
        "source": tree.node_of(headers.source[went_in]),
        "destination": tree.node_of(headers.destination[went_in]),
    }
    stray = {"t_ns": capture.t_ns[off], "protocol": headers.protocol[off], "size": capture.sizes[off]}
    return _CaptureFrames(
        entered,
        mavlink,
        _mqtt_bodies(capture, headers, went_in),
        {"t_ns": capture.t_ns[came_out], "key": key[came_out]},
        stray | {"node": np.full(len(off), number)},
    )


def _mqtt_bodies(capture: CapturedFrames, headers: Headers, chosen: Ints) -> dict[int, bytes]:
    carried = np.isin(headers.protocol[chosen], (MQTT, MQTT_SN)) & (headers.body_end > headers.body)[chosen]
    return {
        int(place): capture.data[headers.body[at] : headers.body_end[at]].tobytes()
        for place, at in zip(np.flatnonzero(carried), chosen[carried], strict=True)
    }


def _mqtt_segments(entered: Columns, bodies: dict[int, bytes]) -> dict[tuple[int, ...], list[Segment]]:
    """The segments of each direction between two ports: (link, source, its port, destination, its port)."""
    segments: dict[tuple[int, ...], list[Segment]] = {}
    names = ("link", "source", "source_port", "destination", "destination_port", "sequence", "flags", "left_ns")
    rows = np.flatnonzero(entered["protocol"] == MQTT)
    for row, *place, sequence, flags, left_ns in zip(rows, *(entered[name][rows] for name in names), strict=True):
        segment = Segment(
            int(row),
            int(left_ns) if left_ns != NOWHERE else None,
            int(sequence),
            bool(flags & SYN),
            bodies.get(row, b""),
        )
        segments.setdefault(tuple(int(number) for number in place), []).append(segment)
    return segments


def _flows_of_datagrams(entered: Columns, bodies: dict[int, bytes]) -> Iterable[list[Datagram]]:
    """The MQTT-SN datagrams of each flow from port to port, on each link."""
    flows: dict[tuple[int, ...], list[Datagram]] = {}
    names = ("link", "source", "source_port", "destination", "destination_port", "left_ns")
    rows = np.flatnonzero(entered["protocol"] == MQTT_SN)
    for row, *place, left_ns in zip(rows, *(entered[name][rows] for name in names), strict=True):
        datagram = Datagram(int(row), int(left_ns) if left_ns != NOWHERE else None, bodies.get(int(row), b""))
        flows.setdefault(tuple(int(number) for number in place), []).append(datagram)
    return flows.values()


def _mqtt_directions(
    segments: dict[tuple[int, ...], list[Segment]], key_log: dict[bytes, dict[str, bytes]]
) -> tuple[list[Direction], int]:
    """Each direction between two ports, and the number of TLS directions that cannot be read to their ends.

    A client's direction, by its CONNECT's protocol level and its TLS session, decides how its broker's is read. A
    broker encrypts before the client has the keys, so where no key was logged only the client's direction shows
    whether one is missing.
    """
    found, unread = [], 0
    versions: dict[tuple[int, ...], int] = {}
    sessions: dict[tuple[int, ...], list[Secrets]] = {}
    brokers = (MQTT_PORT, MQTTS_PORT)
    for flow in sorted(segments, key=lambda flow: flow[4] not in brokers):  # those towards a broker first
        _, source, source_port, destination, destination_port = flow
        there = (source, source_port, destination, destination_port)
        back = (destination, destination_port, source, source_port)
        version = versions.get(back, VERSION_5)
        if MQTTS_PORT in (source_port, destination_port):
            is_clients = destination_port == MQTTS_PORT
            if is_clients:
                sessions[there] = [key_log[one] for one in randoms_of(segments[flow]) if one in key_log]
            known = sessions.get(there if is_clients else back, [])
            direction = read_tls_direction(segments[flow], known, version)
            unread += direction.is_unread and (is_clients or bool(known))
        else:
            direction = read_direction(segments[flow], version)
        if direction.version is not None:
            versions[there] = direction.version
        found.append(direction)
    return found, unread


def _frame_purposes(of_first: pl.Series, entered: Columns, directions: list[Direction]) -> pl.Series:
    """The purpose of each frame: that of its first message, else of the message that it continues, or of TCP itself."""
    is_mqtt, flags = entered["protocol"] == MQTT, entered["flags"]
    rows = np.flatnonzero(of_first.is_null().to_numpy())
    goes_on = {row: packet for direction in directions for row, packet in direction.carried.items()}
    keeps_tls = {row for direction in directions if not direction.is_unread for row in direction.tls_bytes}
    found = []
    for row in rows.tolist():
        if row in goes_on:
            found.append(purposes.of_packet(goes_on[row].kind, goes_on[row].topic))
        elif row in keeps_tls:  # a handshake, a ticket
            found.append("upkeep")
        elif not is_mqtt[row]:
            found.append("other")
        elif flags[row] & _OPENS_OR_ENDS:
            found.append("upkeep")
        else:
            found.append("acknowledgement" if entered["body"][row] == 0 else "other")
    return of_first.scatter(rows, pl.Series(found, dtype=pl.Categorical())).alias("purpose")


def _repeats(count: int, segments: Iterable[list[Segment]], directions: list[Direction]) -> pl.Series:
    """The column `repeats`: whether TCP or MQTT-SN sent a frame's content again, and whether that was needed."""
    found = {row: kind for direction in segments for row, kind in retransmissions(direction).items()}
    for direction in directions:
        found |= {row: NEEDLESS if had_left else NEEDED for row, had_left in direction.repeated.items()}
    kinds = pl.Series(list(found.values()), dtype=pl.Categorical())
    nothing = pl.Series("repeats", [None], dtype=pl.Categorical()).new_from_index(0, count)
    return nothing.scatter(list(found), kinds) if found else nothing


def _begins(messages: pl.Series, directions: list[Direction]) -> pl.Series:
    """The column `begins`: the row of the frame in which the message of a frame's first byte begins."""
    own = pl.Series("begins", np.arange(len(messages)), dtype=pl.Int64()).set(messages == 0, None)
    found = {row: packet.row for direction in directions for row, packet in direction.carried.items()}
    return own.scatter(list(found), list(found.values())) if found else own


def _in_order(columns: Columns) -> tuple[Columns, Ints]:
    """Sort the columns by time, and return them with the sorting indexes; empties `columns`."""
    order = np.argsort(columns["t_ns"], kind="stable")
    return {name: columns.pop(name)[order] for name in list(columns)}, order


def _joined(parts: list[Columns]) -> Columns:
    """The columns of all parts, concatenated."""
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
