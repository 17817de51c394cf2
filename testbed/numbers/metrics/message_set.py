"""The message set: for each of its ten kinds the traffic on the links, the delays and the losses."""

from __future__ import annotations

from typing import Any

import numpy as np
import polars as pl

from ...fly.pcap import Ints
from ..attempt_entry import AmountEntry, KindEntry, KindMessages, KindOfMessages
from ..packets import Packets
from ..statistics import loss_of
from .exchange import Exchange, count_messages
from .message_kinds import own_mavlink, own_mqttxt, setpoints
from .message_spans import MeasuredKind, kinds_of
from .sizes import acknowledgements, message_sizes
from .timeline import histogram
from .ways import Ways
from .window import Window, is_message_set

_SAME_MESSAGE = {"heading": "location"}
"""Over MAVLink one message carries both; an Exchange has it by the second name."""
_BETWEEN = ":"
"""Separates a kind from the name of one of its own messages while all kinds are measured together."""


def measure_kinds(
    packets: Packets, ways: Ways, window: Window, events: list[dict[str, Any]], exchange: Exchange, is_mavlink: bool
) -> dict[str, KindEntry] | None:
    """The entries by kind, in the order of the flight; None if the mission was not the message set."""
    if not is_message_set(events):
        return None
    drones = {drone for event in events if event["event"] == "mission_start" for drone in event["drones"]}
    frames, messages = _numbered(packets.frames, "frame"), _numbered(packets.messages, "row")
    acks = frames.filter(pl.col("purpose").cast(pl.String) == "acknowledgement").select(pl.col("frame").alias("answer"))
    answers = acknowledgements(frames, pl.col("begins").is_not_null()).join(acks, on="answer", how="semi")
    t_ns, said_ns = frames["t_ns"].to_numpy(), messages["t_ns"].to_numpy()
    same = _SAME_MESSAGE if is_mavlink else {}
    found: dict[str, KindEntry] = {}
    all_own = []
    for kind in kinds_of(events):
        rows, said = kind.rows_within(t_ns), messages[kind.rows_within(said_ns)]
        own = own_mavlink(said, kind.name, drones) if is_mavlink else own_mqttxt(said, kind.name, ways)
        all_own.append(own.with_columns((pl.lit(kind.name + _BETWEEN) + pl.col("name")).alias("name")))
        carrying = said.join(own, on="row", how="semi")["frame"]
        mine, later = _own_frames(carrying, frames[rows], answers)
        counted, alone = np.union1d(rows, later), np.union1d(mine, later)
        found[kind.name] = {
            "form": kind.form,
            "asked": kind.asked,
            "received": kind.received,
            "reasons": kind.reasons,
            "seconds": round(kind.seconds, 6),
            "with_states": _traffic(frames[counted]),
            "alone": _traffic(frames[alone]),
            "setpoints": _setpoints(frames, said, ways) if kind.name == "offboard" else None,
            "message_bytes": {},
            **_end_to_end(kind, same.get(kind.name, kind.name), packets, ways, exchange),
            "frames_per_call": exchange.frames_per_call.get(kind.name) if kind.form == "command" else None,
            "delay_app_ms": [call.took_ms for call in kind.calls] if kind.calls else list(kind.ages_ms),
            "size_histogram": histogram(frames["size"].gather(counted)),
        }
    named = pl.concat(all_own) if all_own else pl.DataFrame(schema={"row": pl.Int64(), "name": pl.String()})
    for name, measured in message_sizes(packets, named, window).items():
        kind_name, _, message = name.partition(_BETWEEN)
        found[kind_name]["message_bytes"][message] = measured
    return found


def _own_frames(carrying: pl.Series, within: pl.DataFrame, answers: pl.DataFrame) -> tuple[Ints, Ints]:
    """The frames of `within` that carry own messages or continue one, and the acknowledgements of these frames.

    `answers` has for a frame (`frame`) the one that acknowledges it and does nothing else (`answer`).

    TCP may delay an acknowledgement until after the call has returned; it still counts for the call.
    """
    own = carrying.unique().to_list()
    mine = within.filter(pl.col("begins").is_in(own) | pl.col("frame").is_in(own))["frame"]
    later = answers.filter(pl.col("frame").is_in(mine.to_list()))["answer"]
    return mine.to_numpy(), later.unique().to_numpy()


def _end_to_end(kind: MeasuredKind, name: str, packets: Packets, ways: Ways, exchange: Exchange) -> KindMessages:
    """The kind's messages sent and lost, and the delay of each in order; None: lost.

    `name` is their name in `exchange`.
    """
    if kind.form == "command":
        sent = _of_calls(kind, exchange.commands)
        until_ns = {drone: packets.until_ns[node] for drone, node in ways.drones.items()}
    else:
        sent = exchange.states.filter(kind.entered, pl.col("name") == name).sort("t_ns", maintain_order=True)
        until_ns = exchange.states_until_ns(packets, ways)
    named = sent.with_columns(pl.lit(name).alias("name"))
    nothing: KindOfMessages = {**loss_of(0, 0), "open": 0, "drones": {}}
    counted = count_messages(named, until_ns).get(name, nothing)
    took = ((sent["arrived_ns"] - sent["t_ns"]) / 1e6).round(3).to_list()
    return {
        "sent": counted["sent"],
        "lost": counted["lost"],
        "share": counted["share"],
        "below": counted["below"],
        "open": counted["open"],
        "delay_ms": took,
    }


def _of_calls(kind: MeasuredKind, commands: pl.DataFrame) -> pl.DataFrame:
    """A row for each call: the first of its messages that left the station, with nulls if none did."""
    own = commands.filter(pl.col("name") == kind.name, pl.col("t_ns").is_not_null()).sort("t_ns", maintain_order=True)
    made = np.array([call.t_ns for call in kind.calls], dtype=np.int64)
    left_ns = own["t_ns"].to_numpy()
    firsts = np.searchsorted(left_ns, made, "left")
    nexts = np.append(made[1:], kind.end_ns + 1)
    rows = [
        int(first) if first < len(left_ns) and left_ns[first] < following else None
        for first, following in zip(firsts, nexts, strict=True)
    ]
    wanted = pl.DataFrame({"row": rows}, schema={"row": pl.Int64()})
    drone = commands["drone"].first()
    joined = wanted.join(_numbered(own, "row"), on="row", how="left", maintain_order="left").drop("row")
    return joined.with_columns(pl.col("drone").fill_null(drone))


def _setpoints(frames: pl.DataFrame, said: pl.DataFrame, ways: Ways) -> AmountEntry:
    return _traffic(frames.filter(pl.col("frame").is_in(setpoints(said, ways)["frame"].unique().to_list())))


def _traffic(frames: pl.DataFrame) -> AmountEntry:
    return {"packets": len(frames), "bytes": int(frames["size"].sum())}


def _numbered(table: pl.DataFrame, name: str) -> pl.DataFrame:
    return table.with_row_index(name).with_columns(pl.col(name).cast(pl.Int64))
