"""Arrays to data frames: the columns of the packets table and their types."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import polars as pl

from ...fly.pcap import Ints
from .headers import MAVLINK, MQTT, MQTT_SN, PROTOCOLS
from .links import NOWHERE, Tree
from .mavlink import NONE, MessageColumns, name_of
from .mqtt import Direction

Columns = dict[str, npt.NDArray[Any]]

_CAT = pl.Categorical()
_INT = pl.Int64()
FRAME_SCHEMA = pl.Schema({
    "t_ns": _INT, "left_ns": _INT, "link": _CAT, "source": _CAT, "destination": _CAT, "size": _INT,
    "ethernet": _INT, "ip": _INT, "transport": _INT, "tls": _INT,
    "protocol_bytes": _INT, "payload": _INT,
    "protocol": _CAT, "flow": _CAT, "messages": _INT, "kind": _CAT, "key": pl.UInt64(),
    "node": _CAT, "offset": _INT, "purpose": _CAT, "repeats": _CAT, "lost": pl.Boolean(), "begins": _INT,
})  # fmt: skip
MESSAGE_SCHEMA = pl.Schema({
    "frame": _INT, "t_ns": _INT, "left_ns": _INT, "link": _CAT, "protocol": _CAT, "kind": _CAT, "bytes": _INT,
    "copies": _INT, "topic": pl.String(), "body": pl.Binary(), "version": _INT, "system": _INT,
    "component": _INT, "sequence": _INT, "crc": _INT, "target_system": _INT, "command": _INT,
    **dict.fromkeys(("param1", "param2", "param3"), pl.Float32()),
    "purpose": _CAT,
})  # fmt: skip
_OWN = {name: kind for name, kind in MESSAGE_SCHEMA.items() if name not in ("t_ns", "link", "purpose")}
"""The columns that come from a message itself, not from its frame; the purpose is derived from them."""


_AS_THEY_ARE = ("t_ns", "size", "ethernet", "ip", "transport", "key", "offset", "lost")


def mavlink_rows(parts: list[MessageColumns], rows: Ints, left_ns: Ints) -> pl.DataFrame:
    """Rows of the MAVLink messages in the frames `rows`; all messages of a datagram leave the link together."""
    names = ("version", "system", "component", "sequence", "crc", "size", "target_system", "command", "identity")
    fields: dict[str, Ints] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    params = np.concatenate([part.params for part in parts])
    numbers, codes = np.unique(fields["identity"], return_inverse=True)
    return (
        pl.DataFrame(
            {name: fields[name] for name in ("version", "system", "component", "sequence", "crc")}
            | {"frame": rows, "bytes": fields["size"], "copies": np.ones_like(rows)}
            | {"left_ns": _or_null(left_ns[rows], NOWHERE)}
            | {name: _or_null(fields[name], NONE) for name in ("target_system", "command")}
            | {f"param{number + 1}": pl.Series(params[:, number]).fill_nan(None) for number in range(3)}
            | {"kind": _named([name_of(int(number)) for number in numbers], codes)}
        )
        .select(
            *(
                pl.col(name) if name in _OF_MAVLINK else pl.lit(None, dtype=kind).alias(name)
                for name, kind in _OWN.items()
            )
        )
        .with_columns(pl.lit("mavlink").cast(_CAT).alias("protocol"))
    )


_OF_MAVLINK = set(_OWN) - {"topic", "body", "protocol"}


def mqtt_rows(directions: list[Direction]) -> pl.DataFrame:
    """Rows of the MQTT packets of all connections, and of the MQTT-SN packets that stand for such."""
    packets = [packet for direction in directions for packet in direction.packets]
    table = pl.DataFrame(
        [(p.row, p.left_ns, "mqtt", p.kind, p.size, p.copies, p.topic, p.payload) for p in packets],
        schema={
            "frame": _INT,
            "left_ns": _INT,
            "protocol": _CAT,
            "kind": _CAT,
            "bytes": _INT,
            "copies": _INT,
            "topic": pl.String(),
            "body": pl.Binary(),
        },
        orient="row",
    )
    missing = [pl.lit(None, dtype=kind).alias(name) for name, kind in _OWN.items() if name not in table.columns]
    return table.with_columns(missing).select(list(_OWN))


def frame_rows(
    tree: Tree, nodes: list[str], entered: Columns, messages: pl.DataFrame, payload_bytes: Ints, tls_bytes: Ints
) -> pl.DataFrame:
    """Rows of the frames that entered a link; `payload_bytes` and `tls_bytes` are each frame's bytes of message
    payloads and of TLS."""
    count = len(entered["t_ns"])
    at = messages["frame"].to_numpy()
    protocol, body = entered["protocol"], entered["body"]
    protocol_bytes = np.where(np.isin(protocol, (MQTT, MAVLINK, MQTT_SN)), body - payload_bytes - tls_bytes, 0)
    firsts, places = np.unique(at, return_index=True)
    first = np.full(count, len(messages), dtype=np.int64)
    first[firsts] = places
    flows, flow = _flows(tree, entered)
    return pl.DataFrame(
        {name: entered[name] for name in _AS_THEY_ARE}
        | {"left_ns": _or_null(entered["left_ns"], NOWHERE), "link": _named(tree.links, entered["link"])}
        | {name: _named(tree.nodes, entered[name]) for name in ("source", "destination")}
        | {"tls": tls_bytes, "protocol_bytes": protocol_bytes, "payload": body - tls_bytes - protocol_bytes}
        | {"protocol": _named(PROTOCOLS, protocol), "flow": _named(flows, flow), "node": _named(nodes, entered["node"])}
        | {
            "messages": np.bincount(at, minlength=count),
            **{name: pl.concat([messages[name], _nothing(name)]).gather(first) for name in ("kind", "purpose")},
            "repeats": pl.Series([None] * count, dtype=_CAT),
            "begins": pl.Series([None] * count, dtype=_INT),
        },
        schema_overrides={"messages": _INT},
    ).select(FRAME_SCHEMA.names())


def stray_rows(nodes: list[str], strays: Columns) -> pl.DataFrame:
    """Rows of the frames on no link."""
    told = pl.DataFrame(
        {"t_ns": strays["t_ns"], "size": strays["size"], "protocol": _named(PROTOCOLS, strays["protocol"])}
        | {"node": _named(nodes, strays["node"])}
    )
    missing = [pl.lit(None, dtype=kind).alias(name) for name, kind in FRAME_SCHEMA.items() if name not in told.columns]
    return told.sort("t_ns", maintain_order=True).with_columns(missing).select(FRAME_SCHEMA.names())


def _flows(tree: Tree, entered: Columns) -> tuple[list[str], Ints]:
    """The names of all flows, and the index of each frame's flow."""
    number = entered["source"]
    for name, width in (("source_port", 16), ("destination", 8), ("destination_port", 16)):
        number = number << width | entered[name]
    numbers, codes = np.unique(number, return_inverse=True)
    names = []
    for value in numbers.tolist():
        ports = value >> 24 & 0xFFFF, value & 0xFFFF
        ends = tree.nodes[value >> 40], tree.nodes[value >> 16 & 0xFF]
        names.append(">".join(f"{node}:{port}" if any(ports) else node for node, port in zip(ends, ports, strict=True)))
    return names, codes


def _named(names: list[str] | tuple[str, ...], codes: Ints) -> pl.Series:
    """The name of each code; -1 has none."""
    return pl.Series([*names, None], dtype=_CAT).gather(np.where(codes < 0, len(names), codes))


def _nothing(name: str) -> pl.Series:
    return pl.Series(name, [None], dtype=_CAT)


def _or_null(values: Ints, missing: int) -> pl.Series:
    return pl.Series(values).set(pl.Series(values == missing), None)
