"""Finished series made by hand: results folders with a complete metrics.json, without captures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from testbed.fly.results import METRICS, REPORT, Series, open_series, write_json
from testbed.numbers.statistics import loss_of
from tests.handmade.both_sides import messages, rich_entry, write_metrics

NAME = "20260101T000000Z"


def attempt(protocol: str, number: int = 1, lost: int = 0, **changed: Any) -> dict[str, Any]:
    """A completed attempt in which 18 commands and 100 states were sent; `lost` of the states were lost."""
    entry = rich_entry(protocol, number)
    entry["window"] = {"start_ns": 0, "seconds": entry["mission_s"]}
    entry["messages"] = messages(18, 100, states_lost=lost)
    entry["losses"] = None
    entry["links_measured"] = {}
    return entry | changed


def gave_up(protocol: str, reason: str, number: int = 1) -> dict[str, Any]:
    """A failed attempt, of which ten seconds were counted."""
    window = {"start_ns": 0, "seconds": 10.0}
    return attempt(protocol, number, status="failed", reason=reason, mission_s=None, window=window, size_bytes=100_000)


def message_set(with_states: int, alone: int, lost: int = 0) -> dict[str, Any]:
    """Ten messages each of a command and a state, with these bytes, over ten seconds."""
    found = {}
    for name, form in (("arm", "command"), ("battery", "state")):
        counted = {**loss_of(10, lost), "open": 0}
        found[name] = {
            **{"form": form, "asked": 10, "received": 10 - lost, "reasons": {}, "seconds": 10.0},
            **{"with_states": {"packets": with_states // 100, "bytes": with_states}, "setpoints": None},
            **{"alone": {"packets": alone // 100, "bytes": alone}, "message_bytes": {}, **counted},
            **{"delay_ms": [20.0] * (10 - lost) + [None] * lost, "delay_app_ms": [30.0] * 10, "size_histogram": {}},
            "frames_per_call": 1.0 if form == "command" else None,
        }
    return found


def finished(
    root: Path,
    mqttxt: list[dict[str, Any]],
    mavlink: list[dict[str, Any]],
    *,
    experiment: str = "scenario-1",
    arm: str = "thesis",
    profile: str = "ideal",
    name: str = NAME,
    void: tuple[tuple[int, str], ...] = (),
    **changed: Any,
) -> Series:
    """Make a measured series; `void` are attempts of both protocols that do not count."""
    series = Series(root / experiment / f"{arm}-{profile}" / name)
    series.path.mkdir(parents=True)
    voids = [{"attempt": number, "reason": reason} for number, reason in void]
    sides = {"mavlink": mavlink, "mqttxt": mqttxt}
    protocols = {p: {"attempts": flown, "void": voids} for p, flown in sides.items() if flown or void}
    flown_in = {"experiment": experiment, "arm": arm.partition("+")[0], "profile": profile}
    write_metrics(series, protocols, **flown_in, **changed)
    (series.path / REPORT).write_text("<!doctype html><title>report</title>")
    return series


def both(number: int = 1) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """One completed attempt of each side."""
    return [attempt("mqttxt", number)], [attempt("mavlink", number)]


def count_attempts(path: Path) -> None:
    """Write metrics that contain only which attempts count."""
    sides: dict[str, Any] = {}
    for attempt in open_series(path).attempts():
        side = sides.setdefault(attempt.protocol, {"attempts": [], "void": []})
        told = attempt.manifest()
        entry = {"attempt": attempt.number, "repeat": attempt.repeat, "reason": told["reason"]}
        side["void" if told["status"] == "void" else "attempts"].append(entry)
    write_json(path / METRICS, {"protocols": sides})
