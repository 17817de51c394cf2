"""The traffic that entered the links in the window: frames, bytes by layer, and frames that did not leave."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import polars as pl

from ..packets import Packets
from .window import Window

_TRANSPORT = {"mqtt": "tcp", "tcp": "tcp", "mavlink": "udp", "udp": "udp", "mqttsn": "udp"}
_MESSAGING = {"mqtt": "mqtt", "mavlink": "mavlink", "mqttsn": "mqtt"}
"""The layer that a protocol's framing counts for: MQTT-SN's counts for MQTT."""


@dataclass
class LinkCount:
    """The traffic that entered a directed link: frames, their bytes by layer, and frames that did not leave it."""

    packets: int = 0
    bytes: int = 0
    lost: int = 0
    layers: Counter[str] = field(default_factory=Counter)


def count_links(packets: Packets, window: Window) -> dict[str, LinkCount]:
    """The counts by link, of each link that a frame entered in the window."""
    sums = (
        packets.frames.filter(window.entered)
        .group_by("link", "protocol")
        .agg(
            pl.len(),
            pl.col("lost").sum(),
            pl.col("size", "ethernet", "ip", "transport", "tls", "protocol_bytes", "payload").sum(),
        )
    )
    found: dict[str, LinkCount] = {}
    for row in sums.cast({"link": pl.String, "protocol": pl.String}).sort("link", "protocol").iter_rows(named=True):
        count = found.setdefault(row["link"], LinkCount())
        count.packets += row["len"]
        count.bytes += row["size"]
        count.lost += row["lost"]
        layers = {"ethernet": row["ethernet"], "ip": row["ip"], "payload": row["payload"]}
        layers |= {"tls": row["tls"]} if row["tls"] else {}
        if row["protocol"] in _TRANSPORT:
            layers[_TRANSPORT[row["protocol"]]] = row["transport"]
        if row["protocol"] in _MESSAGING:
            layers[_MESSAGING[row["protocol"]]] = row["protocol_bytes"]
        count.layers.update(layers)
    return found


def count_before(packets: Packets, window: Window) -> dict[str, int]:
    """Frames and bytes on all links before the window; `other` counts frames of no message, as the links' probes."""
    early = packets.frames.filter(pl.col("t_ns") < window.start_ns)
    own = early.filter(pl.col("purpose").cast(pl.String) != "other")
    return {"packets": len(own), "bytes": int(own["size"].sum()), "other": len(early) - len(own)}


def count_foreign(packets: Packets, window: Window) -> dict[str, int]:
    """Frames on no link in the window, by protocol."""
    strays = packets.strays.filter(window.entered)
    return dict(sorted(Counter(strays["protocol"].cast(pl.String).to_list()).items()))


def count_mqtt(packets: Packets, window: Window) -> dict[str, int]:
    """MQTT packets that began in the window, by type."""
    sent = packets.messages.filter(window.entered, pl.col("protocol").cast(pl.String) == "mqtt")
    return dict(sorted(Counter(sent["kind"].cast(pl.String).to_list()).items()))
