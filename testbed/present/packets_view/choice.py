"""The frames of attempts that a user chooses to see."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import polars as pl

from ...errors import ResultsError, UserError
from ...fly.results import Attempt, Series, attempt_of
from ...numbers.metrics import mission_window
from ...numbers.packets.table import Packets, load


@dataclass(frozen=True)
class FrameChoice:
    """Criteria for frames: a link (or a prefix of links' names), a protocol, a kind of message, and a time span.

    Seconds are since the mission's start; None is no limit.
    """

    link: str | None = None
    protocol: str | None = None
    kind: str | None = None
    from_s: float | None = None
    to_s: float | None = None


@dataclass(frozen=True)
class Chosen:
    """An attempt's chosen frames, with their row numbers in the table as `frame`.

    `messages` are the chosen ones that begin in these frames, `every_message` are all of the attempt.
    """

    attempt: Attempt
    frames: pl.DataFrame
    messages: pl.DataFrame
    every_message: pl.DataFrame
    truncated: tuple[str, ...]
    start_ns: int


def find_attempts(run: str, root: Path) -> list[Attempt]:
    """The attempts of a series, of an attempt's folder, or of the newest series (`latest`). Raises UserError if there
    are none."""
    path = Path(run)
    if run == "latest":
        series = [found.resolve() for found in root.glob("*/latest")]
        if not series:
            raise UserError(f"latest: no results in {root}")
        path = max(series, key=lambda folder: folder.name)
    folder = path.resolve()
    attempt = attempt_of(folder)
    if attempt is not None:
        return [attempt]
    attempts = Series(folder).attempts() if folder.is_dir() else []
    if not attempts:
        raise UserError(f"{run}: expected a series (with <protocol>/attempt-NN in it), an attempt's folder, or latest")
    return attempts


def choose(attempts: list[Attempt], choice: FrameChoice) -> list[Chosen]:
    """The chosen frames of each attempt.

    Raises UserError for a link, protocol or kind that none of them has, for invalid times, and for an unreadable
    folder.
    """
    _check_times(choice)
    try:
        tables = [load(attempt) for attempt in attempts]
        starts_ns = [_start_ns(attempt, packets) for attempt, packets in zip(attempts, tables, strict=True)]
        links = [name for attempt in attempts for name in attempt.topology().ends]
    except ResultsError as error:
        raise UserError(str(error)) from error
    if choice.link is not None and not any(_is_below(link, choice.link) for link in links):
        raise UserError(f"--link {choice.link}: expected one of {', '.join(dict.fromkeys(links))}, or a prefix")
    _check_name("--protocol", choice.protocol, [table.frames["protocol"] for table in tables])
    _check_name("--kind", choice.kind, [table.messages["kind"] for table in tables])
    return [_choose(*each, choice) for each in zip(attempts, tables, starts_ns, strict=True)]


def _start_ns(attempt: Attempt, packets: Packets) -> int:
    """When the first arm command's frame left the ground station; without commands, the time of the first frame."""
    window = mission_window(attempt, attempt.events(), packets)
    if window is not None:
        return window.start_ns
    return int(packets.frames["t_ns"][0]) if len(packets.frames) else 0


def _choose(attempt: Attempt, packets: Packets, start_ns: int, choice: FrameChoice) -> Chosen:
    frames, messages = packets.frames.with_row_index("frame"), packets.messages
    frames = frames.with_columns(pl.col("frame").cast(pl.Int64))
    if choice.link is not None:
        link = pl.col("link").cast(pl.String)
        frames = frames.filter((link == choice.link) | link.str.starts_with(f"{choice.link}:"))
    if choice.protocol is not None:
        frames = frames.filter(_is_same("protocol", choice.protocol))
    if choice.from_s is not None:
        frames = frames.filter(pl.col("t_ns") >= start_ns + round(choice.from_s * 1e9))
    if choice.to_s is not None:
        frames = frames.filter(pl.col("t_ns") <= start_ns + round(choice.to_s * 1e9))
    if choice.kind is not None:
        messages = messages.filter(_is_same("kind", choice.kind))
        frames = frames.join(messages.select("frame").unique(), on="frame", how="semi")
    messages = messages.join(frames.select("frame"), on="frame", how="semi")
    return Chosen(attempt, frames, messages, packets.messages, packets.truncated, start_ns)


def _check_times(choice: FrameChoice) -> None:
    for option, value in (("--from", choice.from_s), ("--to", choice.to_s)):
        if value is not None and not math.isfinite(value):
            raise UserError(f"{option} {value}: expected seconds since the mission's start")
    if choice.from_s is not None and choice.to_s is not None and choice.from_s > choice.to_s:
        raise UserError(f"--from {choice.from_s:g} --to {choice.to_s:g}: expected --from to be the earlier one")


def _check_name(option: str, name: str | None, columns: Iterable[pl.Series]) -> None:
    known = sorted({value for column in columns for value in column.cast(pl.String).unique() if value is not None})
    if name is not None and name.lower() not in (value.lower() for value in known):
        raise UserError(f"{option} {name}: expected one of {', '.join(known) or 'none: the run has no messages'}")


def _is_same(column: str, name: str) -> pl.Expr:
    return pl.col(column).cast(pl.String).str.to_lowercase() == name.lower()


def _is_below(link: str, name: str) -> bool:
    return link == name or link.startswith(f"{name}:")
