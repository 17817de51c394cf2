"""The output for chosen frames: a table, each one dissected, or their messages by kind."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Any

import polars as pl
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from ..present.packets_view.choice import Chosen, FrameChoice
from ..present.packets_view.dissected import dissect, mavlink_frames, read_frame
from ..present.packets_view.words import said_by_frame, said_by_publish

_SAID = 3
"""The most messages of a frame that its row shows."""
_NARROWEST = 20
"""The least width in characters of the column with a frame's messages, however narrow the terminal is."""


def print_chosen(chosen: Chosen, choice: FrameChoice, console: Console, show: int | None, rows: int) -> None:
    """Print one attempt: the first `show` frames dissected, or a table of the first `rows`, and messages by kind."""
    console.print(f"[bold]{escape(_shown(chosen.attempt.path))}[/]", soft_wrap=True)
    if chosen.truncated:
        console.print(f"cut off, read up to the cut: {', '.join(chosen.truncated)}", markup=False)
    if chosen.frames.is_empty():
        console.print("  no frame matches")
        return
    if show is not None:
        _print_frames(chosen, show, console)
        return
    if rows:
        console.print(_table_of_frames(chosen, rows, console.width))
    console.print(_table_of_kinds(chosen, choice))


def _table_of_frames(chosen: Chosen, count: int, width: int) -> Table:
    """A table of the first `count` frames; their messages are cut so that all columns fit into `width` characters."""
    listed = chosen.frames.head(count)
    messages = _messages_by_frame(chosen, listed)
    lines = []
    for frame in listed.iter_rows(named=True):
        found = messages[frame["frame"]]
        time_s = (frame["t_ns"] - chosen.start_ns) / 1e9
        head = [f"{time_s:.6f}", frame["link"], str(frame["size"]), frame["protocol"], _kinds(found), _left(frame)]
        lines.append((head, "; ".join(_said(chosen, frame, found[:_SAID]))))
    names = ("t [s]", "link", "bytes", "protocol", "kind", "left [ms]")
    widths = [max(len(name), *(len(head[at]) for head, _ in lines)) for at, name in enumerate(names)]
    room = max(_NARROWEST, width - sum(widths) - 2 * len(widths) - 2)
    table = Table(box=None, header_style="bold", caption_justify="left")
    for name, wide in zip(names, widths, strict=True):
        right = name in ("t [s]", "bytes", "left [ms]")
        table.add_column(escape(name), justify="right" if right else "left", no_wrap=True, min_width=wide)
    table.add_column("says", no_wrap=True)
    for head, said in lines:
        table.add_row(*map(escape, head), escape(said if len(said) <= room else f"{said[: room - 2]} …"))
    if len(chosen.frames) > count:
        table.caption = f"… and {len(chosen.frames) - count:,} more (--rows {len(chosen.frames)})"
    return table


def _print_frames(chosen: Chosen, count: int, console: Console) -> None:
    listed = chosen.frames.head(count)
    messages = _messages_by_frame(chosen, listed)
    for frame in listed.iter_rows(named=True):
        found = messages[frame["frame"]]
        time_s = (frame["t_ns"] - chosen.start_ns) / 1e9
        left = _left(frame)
        console.print(
            f"\n[bold]{time_s:.6f} s  {frame['link']}[/]  {frame['size']} bytes, {escape(frame['flow'])}, "
            f"{left if left == 'lost' else f'{left} ms on the link'}"
        )
        packet = dissect(_packet(chosen, frame), frame["protocol"], [message["kind"] for message in found])
        console.print(str(packet.show(dump=True)).rstrip(), markup=False, soft_wrap=True)
        for message in found:
            if message["topic"] is not None:
                said = said_by_publish(message["topic"], message["body"] or b"")
                console.print(f"{message['topic'] or 'a topic alias'}: {said}", markup=False, soft_wrap=True)
    if len(chosen.frames) > count:
        console.print(f"\n… and {len(chosen.frames) - count:,} more")


def _table_of_kinds(chosen: Chosen, choice: FrameChoice) -> Table:
    """A table of messages by kind, counted on every link that they cross, and of the frames in which none begins."""
    span_s = _span_s(chosen, choice)
    frames = chosen.frames
    lost = int(frames["left_ns"].is_null().sum())
    table = Table(box=None, header_style="bold", caption_justify="left")
    for name in ("protocol", "kind"):
        table.add_column(name, no_wrap=True)
    for name in ("messages", "bytes", "per message", "per second"):
        table.add_column(name, justify="right", no_wrap=True)
    counted = (
        chosen.messages.group_by(pl.col("protocol").cast(pl.String), pl.col("kind").cast(pl.String))
        .agg(pl.len().alias("count"), pl.col("bytes").sum())
        .sort("count", "kind", descending=[True, False])
    )
    for row in counted.iter_rows(named=True):
        count, size = row["count"], row["bytes"]
        per_second = f"{count / span_s:,.2f}" if span_s else ""
        table.add_row(
            row["protocol"], escape(row["kind"]), f"{count:,}", f"{size:,}", f"{size / count:.1f}", per_second
        )
    silent = frames.filter(pl.col("messages") == 0)
    caption = [
        f"{len(frames):,} frames, {frames['size'].sum():,} bytes with all headers, {lost:,} lost, in {span_s:.3f} s"
    ]
    if len(silent):
        caption.append(f"in {len(silent):,} of them ({silent['size'].sum():,} bytes) no message begins")
    table.caption = "\n".join(caption)
    return table


def _span_s(chosen: Chosen, choice: FrameChoice) -> float:
    """The chosen time span in seconds; without a limit, from the first chosen frame or to the last."""
    first, last = chosen.frames["t_ns"][0], chosen.frames["t_ns"][-1]
    start_ns = first if choice.from_s is None else chosen.start_ns + round(choice.from_s * 1e9)
    end_ns = last if choice.to_s is None else chosen.start_ns + round(choice.to_s * 1e9)
    return float(end_ns - start_ns) / 1e9


def _messages_by_frame(chosen: Chosen, frames: pl.DataFrame) -> dict[int, list[dict[str, Any]]]:
    """All messages that begin in the frames, not only those of the chosen kind."""
    found: dict[int, list[dict[str, Any]]] = defaultdict(list)
    columns = ("frame", "kind", "topic", "body")
    own = chosen.every_message.join(frames.select("frame"), on="frame", how="semi").select(columns)
    for message in own.iter_rows(named=True):
        found[message["frame"]].append(message)
    return found


def _said(chosen: Chosen, frame: dict[str, Any], messages: list[dict[str, Any]]) -> list[str]:
    """The messages' contents as text; MAVLink's fields are read from the capture."""
    if frame["protocol"] == "mavlink":
        packet = dissect(_packet(chosen, frame), "mavlink", [])
        return [said_by_frame(layer) for layer in mavlink_frames(packet)[: len(messages)]]
    said = []
    for message in messages:
        if message["topic"] is not None:
            what = said_by_publish(message["topic"], message["body"] or b"")
            said.append(f"{message['topic'] or 'a topic alias'} {what}")
    return said


def _packet(chosen: Chosen, frame: dict[str, Any]) -> Any:
    return read_frame(chosen.attempt.path / "pcap" / f"{frame['node']}.pcap", frame["offset"])


def _kinds(messages: list[dict[str, Any]]) -> str:
    """The kind of the first message, and how many more there are."""
    more = f" +{len(messages) - 1}" if len(messages) > 1 else ""
    return f"{messages[0]['kind']}{more}" if messages else "-"


def _left(frame: dict[str, Any]) -> str:
    return "lost" if frame["left_ns"] is None else f"{(frame['left_ns'] - frame['t_ns']) / 1e6:.3f}"


def _shown(path: Path) -> str:
    return str(path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path)
