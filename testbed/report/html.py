"""The page: one self-contained HTML file, the same bytes for the same results."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jinja2

from ..metrics import mission_window
from ..results import REPORT, Attempt, Series
from . import comparison, details, factors, sentences, words
from .figures import Panel, flights_of, steps_of, timeline

TEMPLATES = Path(__file__).parent / "page"


def write_report(series: Series, metrics: dict[str, Any]) -> Path:
    """Write `report.html` into the series folder; returns its path."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= {
        name: getattr(words, name)
        for name in ("size", "seconds", "milliseconds", "thousands", "digits", "ratio", "percent", "name_of")
    }
    environment.filters["tied"] = lambda text: text.replace("(< ", "(<\xa0").replace(" %", "\xa0%")
    environment.filters["at"] = lambda percent: f"{percent:.2f}%"
    attempts = [_attempt(series, attempt, metrics) for attempt in series.attempts()]
    attempts.sort(key=lambda one: (list(dict(words.sides(metrics))).index(one["protocol"]), one["number"]))
    page = environment.get_template("report.html").render(
        metrics=metrics,
        title=words.EXPERIMENT_NAMES.get(metrics["experiment"], metrics["experiment"]),
        what=words.EXPERIMENT_WHAT.get(metrics["experiment"], ""),
        series=series.path.name,
        finding=sentences.finding(metrics),
        basis=sentences.basis(metrics),
        troubles=[attempt for attempt in attempts if attempt["trouble"]],
        **_conditions(series, metrics, attempts),
        protocols=[protocol for protocol, _ in words.sides(metrics)],
        rows=comparison.rows(metrics),
        lost=words.short_loss,
        attempts=attempts,
        **_in_detail(metrics, attempts),
    )
    target = series.path / REPORT
    target.write_text(page, encoding="utf-8")
    return target


def _conditions(series: Series, metrics: dict[str, Any], attempts: list[dict[str, Any]]) -> dict[str, Any]:
    """How the series was flown: its factors in words, and whether at one revision."""
    configuration: dict[str, Any] = {}
    for attempt in attempts:
        configuration = {**attempt["manifest"]["configuration"], **configuration}
    both = len(metrics["protocols"]) > 1
    return {
        "factors": {protocol: factors.factors_of(configuration, protocol) for protocol, _ in words.sides(metrics)},
        "fairness": factors.fairness(configuration) if both else [],
        "deviations": factors.deviations(series.path.parent.name, metrics["arm"], metrics["profile"]),
        "revisions": len({str(attempt["manifest"]["revision"].get("commit")) for attempt in attempts}),
    }


def _in_detail(metrics: dict[str, Any], attempts: list[dict[str, Any]]) -> dict[str, Any]:
    """The tables and figures of one attempt of each protocol."""
    shown = comparison.shown(metrics)
    of = {p: next(a for a in attempts if (a["protocol"], a["number"]) == (p, shown[p]["attempt"])) for p in shown}
    commands = list(dict.fromkeys(command for attempt in of.values() for command in attempt["commands"]))
    grids = {p: details.outcomes_of(shown[p], commands) for p in shown}
    drones = sorted({drone for grid in grids.values() for drone in grid}, key=lambda drone: (len(drone), drone))
    roles = details.roles_of({p: cpu for p in shown if (cpu := _cpu(shown[p], of[p]["manifest"]))})
    routers = details.routers_of(shown["mavlink"]) if "mavlink" in shown else []
    return {
        "shown": of,
        "timeline": timeline([attempt["panel"] for attempt in of.values() if attempt["panel"] is not None]),
        "bars": details.bars_of(shown),
        "layer_names": [name for name, _ in details.LAYERS] + ["other"],
        "links": details.links_of(shown),
        "commands": commands,
        "by_command": {
            p: {name: details.command_of(shown[p], of[p]["events"], name) for name in commands} for p in shown
        },
        "grid": [(drone, {p: grids[p].get(drone, [None] * len(commands)) for p in shown}) for drone in drones],
        "mix": details.mix_of(shown["mavlink"]) if "mavlink" in shown else None,
        "routers": routers,
        "copies": any(r["out"] > r["in"] for _, ways in routers for r in ways.values()),
        "roles": roles,
        "own_cpu": details.protocols_own(roles),
        "most_cpu": max((seconds for role in roles for seconds in role.sums.values()), default=0.0),
    }


def _attempt(series: Series, attempt: Attempt, metrics: dict[str, Any]) -> dict[str, Any]:
    """What the page shows of one attempt; `measured` is None for a void one."""
    manifest = attempt.manifest()
    side = metrics["protocols"][attempt.protocol]
    measured = next((entry for entry in side["attempts"] if entry["attempt"] == attempt.number), None)
    void = next((entry for entry in side["void"] if entry["attempt"] == attempt.number), None)
    events = attempt.events()
    captures = manifest.get("captures", [])
    panel = _panel(attempt, events, measured) if measured is not None else None
    return {
        "number": attempt.number,
        "protocol": attempt.protocol,
        "name": words.name_of(attempt.protocol),
        "manifest": manifest,
        "measured": measured,
        "trouble": _trouble(measured, void, events),
        "folder": attempt.path.relative_to(series.path).as_posix(),
        "files": [path.relative_to(series.path).as_posix() for path in _files(attempt)],
        "panel": panel,
        "timeline": timeline([panel]) if panel is not None else None,
        "events": events,
        "commands": list(dict.fromkeys(event["command"] for event in events if event["event"] == "command")),
        "dropped": sum(capture.get("dropped") or 0 for capture in captures),
        "captured": sum(capture.get("captured") or 0 for capture in captures),
    }


def _trouble(
    measured: dict[str, Any] | None, void: dict[str, Any] | None, events: list[dict[str, Any]]
) -> dict[str, Any] | None:
    """Why an attempt failed or does not count, how far it came, and which captures were cut off."""
    truncated = measured.get("truncated", []) if measured is not None else []
    status = "void" if measured is None else measured["status"]
    if status == "completed" and not truncated:
        return None
    reason = measured["reason"] if measured is not None else void["reason"] if void is not None else None
    first, _, rest = (reason or "").strip().partition("\n")
    steps = [event for event in events if event["event"] == "step_done"]
    begun = [event["name"] for event in events if event["event"] == "step"]
    done = [event["name"] for event in steps if event["ok"]]
    return {
        "status": status,
        "reason": first or "no reason given",
        "more": rest,
        "done": done,
        "step": next((name for name in begun if name not in done), None),
        "begun": any(event["event"] == "mission_start" for event in events),
        "words": sentences.not_completed(measured["outcomes"], reason or "") if measured is not None else [],
        "truncated": truncated,
    }


def _panel(attempt: Attempt, events: list[dict[str, Any]], measured: dict[str, Any]) -> Panel | None:
    window = mission_window(attempt, events)
    if window is None:
        return None
    return Panel(
        protocol=attempt.protocol,
        end_s=window.seconds,
        flights=flights_of(attempt.autopilot_events(), events, window.start_ns),
        steps=steps_of(events, window.start_ns, window.seconds),
        completed=measured["status"] == "completed",
    )


def _cpu(measured: dict[str, Any], manifest: dict[str, Any]) -> dict[str, float]:
    found: dict[str, float] = measured.get("cpu_s") or manifest.get("cpu_s") or {}
    return found


def _files(attempt: Attempt) -> list[Path]:
    patterns = ("manifest.json", "events.jsonl", "pcap/*.pcap", "packets.parquet", "sitl/*.jsonl", "logs/*.log")
    return [path for pattern in patterns for path in sorted(attempt.path.glob(pattern))]
