"""Delays: one way by the captures, and as the applications themselves measured them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from typing import Any

import numpy as np
import polars as pl

from ..attempt_entry import DelaysEntry, Receipts, Summary
from .exchange import calls_in
from .mavlink import CALLS
from .window import Window

LEAST_FOR_P99 = 1000
"""The least number of values for a meaningful 99th percentile."""


def summary(values: list[float]) -> Summary:
    """Summarize values: n, mean, p50, p90, p99 (None below 1,000 values) and max; without values all but n are None."""
    if not values:
        return {"n": 0, "mean": None, "p50": None, "p90": None, "p99": None, "max": None}
    p50, p90, p99 = (round(float(value), 3) for value in np.percentile(values, (50, 90, 99)))
    return {
        "n": len(values),
        "mean": round(sum(values) / len(values), 3),
        "p50": p50,
        "p90": p90,
        "p99": p99 if len(values) >= LEAST_FOR_P99 else None,
        "max": round(max(values), 3),
    }


def by_capture_ms(sent: pl.DataFrame) -> dict[str, list[float]]:
    """By name the delay of each message that arrived, in the order of sending."""
    found: dict[str, list[float]] = defaultdict(list)
    rows = sent.filter(pl.col("t_ns").is_not_null() & pl.col("arrived_ns").is_not_null()).sort(
        "name", "t_ns", "drone", maintain_order=True
    )
    for name, t_ns, arrived_ns in rows.select("name", "t_ns", "arrived_ns").iter_rows():
        found[name].append(round((arrived_ns - t_ns) / 1e6, 3))
    return dict(found)


def calls_ms(events: list[dict[str, Any]], window: Window) -> dict[str, list[float]]:
    """By command the times from the API call until the calling program had its first word about a drone."""
    calls = {event["call"]: event for event in calls_in(events, window)}
    heard: set[tuple[Any, Any]] = set()
    found: dict[str, list[float]] = defaultdict(list)
    for event in events:
        if event["event"] != "outcome" or event["drone"] is None or event["call"] not in calls:
            continue
        if (event["call"], event["drone"]) not in heard:
            heard.add((event["call"], event["drone"]))
            call = calls[event["call"]]
            found[str(call["command"])].append(round((event["t_ns"] - call["t_ns"]) / 1e6, 3))
    return dict(sorted(found.items()))


def receipts(
    events: list[dict[str, Any]],
    flights: dict[str, list[dict[str, Any]]],
    drones_of: dict[int, list[int]],
    window: Window,
) -> Receipts | None:
    """Count the calls, and the commands that autopilots received again or after the last word, by the autopilots' logs;
    None if these have no commands, as those of real autopilots.

    `flights` are the autopilots' logs by node, `drones_of` the drones of each fog.
    """
    arrived = _commands(flights)
    if not any(arrived.values()):
        return None
    ended = {(e["call"], e["drone"]): e["t_ns"] for e in events if e["event"] == "outcome" and e["final"]}
    found: Receipts = {"calls": 0, "doubled": 0, "late": 0}
    for drone, call, came in _received(events, arrived, drones_of, window):
        found["calls"] += 1
        found["doubled"] += max(0, len(came) - 1)
        found["late"] += sum(at > ended.get((call["call"], drone), 2**63) for at in came)
    return found


def received_ms(
    events: list[dict[str, Any]],
    flights: dict[str, list[dict[str, Any]]],
    drones_of: dict[int, list[int]],
    window: Window,
) -> dict[str, list[float]]:
    """By command the times from the API call until the autopilot received it, by the autopilot's own log; `flights` and
    `drones_of` as in `receipts`."""
    found: dict[str, list[float]] = defaultdict(list)
    for _, call, came in _received(events, _commands(flights), drones_of, window):
        if came:
            found[str(call["command"])].append(round((came[0] - call["t_ns"]) / 1e6, 3))
    return dict(sorted(found.items()))


def _commands(flights: dict[str, list[dict[str, Any]]]) -> dict[int, list[dict[str, Any]]]:
    """By drone the commands that its autopilot logged as received."""
    return {
        int(node.removeprefix("uav")): [e for e in log if e["event"] == "command" and "arrived_ns" in e]
        for node, log in flights.items()
        if node.removeprefix("uav").isdecimal()
    }


def _received(
    events: list[dict[str, Any]],
    arrived: dict[int, list[dict[str, Any]]],
    drones_of: dict[int, list[int]],
    window: Window,
) -> Iterator[tuple[int, dict[str, Any], list[int]]]:
    """Each call to a drone, and when its autopilot received the command: a call counts until the next one of the same
    command to that drone."""
    calls = [
        (drone, event)
        for event in calls_in(events, window)
        if event["command"] in CALLS
        for drone in _called(event, drones_of)
    ]
    for place, (drone, call) in enumerate(calls):
        until_ns = next(
            (c["t_ns"] for d, c in calls[place + 1 :] if (d, c["command"]) == (drone, call["command"])), 2**63
        )
        of_call = CALLS[call["command"]]
        came = [
            command["arrived_ns"]
            for command in arrived.get(drone, [])
            if call["t_ns"] <= command["arrived_ns"] < until_ns and of_call.is_of(command)
        ]
        yield drone, call, came


def _called(call: dict[str, Any], drones_of: dict[int, list[int]]) -> list[int]:
    """The drones that a call is for: one, or all of its fog."""
    return [call["drone"]] if call["drone"] is not None else drones_of.get(call["fog"], [])


def states_ms(states: pl.DataFrame, events: list[dict[str, Any]], window: Window) -> dict[str, DelaysEntry]:
    """Delays by state: `captures` from drone to station; `app` the age (an upper bound) that the ground station's
    program received with the value, None where the protocol has none."""
    by_capture = by_capture_ms(states)
    ages: dict[str, list[float]] = defaultdict(list)
    for event in events:
        if event["event"] == "state" and event.get("age_ms") is not None and window.holds(event["t_ns"]):
            ages[event["name"]].append(float(event["age_ms"]))
    return {
        name: {
            "captures": summary(by_capture.get(name, [])),
            "app": summary(ages[name]) if name in ages else None,
        }
        for name in sorted({*by_capture, *ages})
    }
