"""The packets table of an attempt: a row for each frame that entered a link, and a row for each message in it.

`packets.parquet` and `messages.parquet` in the attempt's folder are a cache; they are made again when a capture or the
version of the table has changed. Times are nanoseconds since the epoch, sizes bytes.

`frames` (sorted by `t_ns`; a frame is referred to by its row number):

| column | type | meaning |
|---|---|---|
| `t_ns` | i64 | when it entered the link, by the capture at the link's sending node |
| `left_ns` | i64 or null | when the first copy left the link unchanged, by the capture at the receiving node |
| `lost` | bool | it never left, though the receiver's capture went on longer than any frame was on that link |
| `link` | categorical | `air:uav1:up`; up is towards the cloud, so what the ground station sends is on `wan:gs:up` |
| `source`, `destination` | categorical | the nodes with its IP addresses |
| `size` | i64 | the Ethernet frame without the FCS |
| `ethernet`, `ip`, `transport` | i64 | bytes of headers (Ethernet with its padding; TCP or UDP) |
| `tls` | i64 | bytes of TLS: what its records add to their data, and handshakes |
| `protocol_bytes` | i64 | framing of MQTT or MAVLink |
| `payload` | i64 | the rest: payloads of PUBLISHes and of MAVLink messages; the content of other protocols |
| `protocol` | categorical | mqtt (in TLS too), mqttsn, mavlink, tcp, udp, icmp, igmp or other |
| `flow` | categorical | `uav1:14540>fog1:14541`; without ports where there are none |
| `messages` | i64 | how many messages begin in it; 0 for a bare TCP acknowledgement |
| `kind` | categorical or null | the first of them |
| `key` | u64 | distinguishes it from the other frames of its link; the same at both ends |
| `node` | categorical | the node whose capture has it as it entered: `pcap/<node>.pcap` … |
| `offset` | i64 | … and the position of its first byte in that file |
| `purpose` | categorical | of its first message, else of the message that it continues, or of TCP itself |
| `repeats` | categorical or null | of a repetition by TCP or MQTT-SN: `needed` if a link had lost it, else `needless` |
| `begins` | i64 or null | the row of the frame in which the message of its first byte begins; null: no message |

`messages` (sorted by `t_ns`, and by their order within a frame):

| column | type | meaning |
|---|---|---|
| `frame` | i64 | the row in `frames` of the frame in which it begins |
| `t_ns`, `link` | | that frame's |
| `left_ns` | i64 or null | when it had left the link, its first copy; over TCP with all that was sent before it |
| `protocol`, `kind` | categorical | mqtt or mavlink; `publish`, `puback`, …, or `HEARTBEAT`, … |
| `bytes` | i64 or null | of the message without lower layers; null: cut off |
| `copies` | i64 | frames that carried its first byte: more than one for a TCP retransmission |
| `topic` | text or null | of a PUBLISH; empty where only an alias is known |
| `body` | binary or null | payload of a PUBLISH |
| `version` | i64 or null | MAVLink 1 or 2 |
| `system`, `component`, `sequence`, `crc` | i64 or null | MAVLink's; with `kind` a message's key from end to end |
| `target_system` | i64 or null | of MAVLink messages that have one |
| `command` | i64 or null | MAV_CMD of COMMAND_LONG, COMMAND_INT, COMMAND_ACK |
| `param1` … `param3` | f32 or null | of COMMAND_LONG and COMMAND_INT |
| `purpose` | categorical | command, result, state, presence, sensor, upkeep, acknowledgement or other |
"""

from __future__ import annotations

import json
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import polars as pl

from ...errors import ResultsError
from ...fly.results import Attempt, fresh_beside
from .build import Built, build
from .rows import FRAME_SCHEMA, MESSAGE_SCHEMA

VERSION = 11
"""Raised with every change of a column's meaning or of how it is computed."""
FRAMES, MESSAGES = "packets.parquet", "messages.parquet"
_ABOUT = "testbed"
_TOLD = ("truncated", "unmatched", "duplicates", "until_ns", "unread")


@dataclass(frozen=True)
class Packets:
    """The packets table. `truncated` names capture files that were cut off, which are read up to the cut.

    `strays` (`t_ns`, `node`, `protocol`, `size`) are frames on no link, such as ARP, once for each capture that has
    them; `foreign` counts them by protocol. `unmatched` counts the frames that left a link and were not seen entering
    it, `duplicates` those of them that are further copies of a frame that was. `until_ns` is until when the capture at
    each node is complete, 0 without one. `unread` counts the TLS flows of which the table lacks messages, because the
    attempt's key log does not open them.
    """

    frames: pl.DataFrame
    messages: pl.DataFrame
    truncated: tuple[str, ...]
    foreign: dict[str, int]
    strays: pl.DataFrame
    unmatched: int
    duplicates: int
    until_ns: dict[str, int]
    unread: int


def load(attempt: Attempt) -> Packets:
    """Load an attempt's table, from the cache if up to date. Raises ResultsError for a file that is no capture."""
    sources = _sources(attempt)
    cached = _read(attempt.path, sources)
    if cached is not None:
        return cached
    built = build(attempt)
    _write(attempt.path, built, sources)
    return _packets(built)


def _sources(attempt: Attempt) -> dict[str, list[int]]:
    """Size and modification time of each file that the table is made from, but the topology, which never changes."""
    beside = (attempt.path / "pcap" / "captures.json", attempt.path / "events.jsonl", attempt.key_log)
    paths = [*sorted((attempt.path / "pcap").glob("*.pcap")), *beside]
    found = {path.name: path.stat() for path in paths if path.exists()}
    return {name: [stat.st_size, stat.st_mtime_ns] for name, stat in found.items()}


def _read(folder: Path, sources: dict[str, list[int]]) -> Packets | None:
    """Read the cache; None if it is missing, damaged, or made from other captures or by another version."""
    frames, messages = folder / FRAMES, folder / MESSAGES
    try:
        about = json.loads(pl.read_parquet_metadata(frames)[_ABOUT])
        same = json.loads(pl.read_parquet_metadata(messages)[_ABOUT])["made"] == about["made"]
        if not same or about["version"] != VERSION or about["sources"] != sources:
            return None
        rows = pl.read_parquet(frames)
        told = (about[name] for name in _TOLD)
        return _packets(Built(rows, pl.read_parquet(messages), *told))
    except (OSError, ValueError, KeyError, pl.exceptions.PolarsError):
        return None


def _write(folder: Path, built: Built, sources: dict[str, list[int]]) -> None:
    """Write the cache, each file completely or not at all; `_read` takes two files only if made together."""
    about: dict[str, Any] = {"version": VERSION, "made": time.time_ns(), "sources": sources}
    about |= {name: getattr(built, name) for name in _TOLD}
    for name, table in ((MESSAGES, built.messages), (FRAMES, built.rows)):
        fresh = fresh_beside(folder / name)
        try:
            table.write_parquet(fresh, compression="lz4", metadata={_ABOUT: json.dumps(about)})
            fresh.replace(folder / name)
        except OSError as error:
            fresh.unlink(missing_ok=True)
            raise OSError(error.errno, error.strerror, str(folder / name)) from error


def _packets(built: Built) -> Packets:
    """Split off the strays, which are the rows without a link, at the end."""
    rows, messages = built.rows, built.messages
    if rows.schema != FRAME_SCHEMA or messages.schema != MESSAGE_SCHEMA:
        raise ResultsError("the packets table has other columns than expected")
    strays = rows.filter(pl.col("link").is_null()).select("t_ns", "node", "protocol", "size")
    foreign = Counter(strays["protocol"].cast(pl.String).to_list())
    frames = rows.head(len(rows) - len(strays))
    return Packets(
        frames=frames,
        messages=messages,
        truncated=tuple(built.truncated),
        foreign=dict(sorted(foreign.items())),
        strays=strays,
        unmatched=built.unmatched,
        duplicates=built.duplicates,
        until_ns=built.until_ns,
        unread=built.unread,
    )
