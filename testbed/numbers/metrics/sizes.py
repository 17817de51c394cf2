"""Packet size by message kind: the frame that carries one message between two nodes, and the cost of its ACK."""

from __future__ import annotations

import polars as pl

from ..attempt_entry import SizeEntry
from ..packets import Packets
from ..statistics import significant
from .window import Window


def message_sizes(packets: Packets, named: pl.DataFrame, window: Window) -> dict[str, SizeEntry]:
    """By kind, over all links: whole frames' bytes, the message's share of a frame that carries several, its ACK.

    `named` has the columns `row` (in the messages table) and `name`. `ack_bytes` is the mean cost of a frame's
    acknowledgement on the way back, TCP's own or MQTT's; None without one, as over UDP, where a command's COMMAND_ACK
    is the kind `NAME ack`. A message that spans several frames counts with the first.
    """
    if named.is_empty():
        return {}
    messages = packets.messages.with_row_index("row").with_columns(pl.col("row").cast(pl.Int64))
    frames = packets.frames.with_row_index("frame").with_columns(pl.col("frame").cast(pl.Int64))
    whole = pl.max_horizontal(pl.col("bytes").fill_null(0).sum().over("frame"), pl.lit(1))
    messages = messages.with_columns((pl.col("bytes").fill_null(0) / whole).alias("part"))
    own = (
        named.join(messages.filter(window.entered).select("row", "frame", "part"), on="row", how="inner")
        .join(frames.select("frame", "size", "link", "flow", "left_ns"), on="frame", how="left")
        .sort("name", "row")
    )
    costs = own.join(acknowledgements(frames, pl.col("messages") > 0), on="frame", how="left", maintain_order="left")
    found: dict[str, SizeEntry] = {}
    for (name,), group in costs.group_by("name", maintain_order=True):
        size, share = group["size"], (group["size"] * group["part"]).to_list()
        acked = group["ack"].drop_nulls().to_list()
        found[str(name)] = {
            "n": len(group),
            "mean": significant(sum(size.to_list()) / len(group)),
            "min": int(size.min() or 0),  # type: ignore[arg-type]
            "max": int(size.max() or 0),  # type: ignore[arg-type]
            "share": significant(sum(share) / len(group)),
            "ack_bytes": significant(sum(acked) / len(acked)) if acked else None,
        }
    return found


def acknowledgements(frames: pl.DataFrame, carrying: pl.Expr) -> pl.DataFrame:
    """For each MQTT frame selected by `carrying` that left its link, the frame that acknowledged it (`answer`) and the
    bytes that this cost (`ack`). `frames` has a column `frame` with each one's row.

    TCP acknowledges with the next frame on the way back. The size of a bare acknowledgement or a PUBACK is divided
    among all frames that it acknowledges; a frame that carries anything else costs nothing.
    """
    mqtt = frames.filter(pl.col("protocol").cast(pl.String) == "mqtt").select(
        "frame",
        "t_ns",
        "left_ns",
        "size",
        "messages",
        "begins",
        *(pl.col(name).cast(pl.String) for name in ("link", "flow", "purpose")),
    )
    back = {"up": "down", "down": "up"}
    link = pl.col("link").str.split(":")
    reverse = pl.col("flow").str.split(">")
    sent = (
        mqtt.filter(carrying, pl.col("left_ns").is_not_null())
        .select(
            "frame",
            pl.col("left_ns").alias("at"),
            (link.list.head(2).list.join(":") + ":" + link.list.last().replace_strict(back)).alias("link"),
            (reverse.list.last() + ">" + reverse.list.first()).alias("flow"),
        )
        .sort("at", maintain_order=True)
    )
    answers = mqtt.select(
        "link",
        "flow",
        pl.col("t_ns").alias("at"),
        pl.col("frame").alias("answer"),
        pl.when(pl.col("purpose") == "acknowledgement").then(pl.col("size")).otherwise(0).alias("cost"),
    ).sort("at", maintain_order=True)
    found = sent.join_asof(answers, on="at", by=["link", "flow"], strategy="forward", check_sortedness=False)
    shared = found.filter(pl.col("answer").is_not_null()).with_columns(pl.len().over("answer").alias("answered"))
    return shared.select("frame", "answer", (pl.col("cost") / pl.col("answered")).alias("ack"))
