"""Metrics of a series: every attempt's numbers, written to `metrics.json`."""

from __future__ import annotations

import json
from pathlib import Path
from statistics import median
from typing import Any

import jsonschema

from ..errors import ResultsError
from ..results import METRICS, Series, write_json
from ..validity import common_revision
from .attempt import measure_attempt
from .statistics import statistics

METRICS_VERSION = 1
"""Rises when a field goes or its meaning changes; fields that are added leave it as it is."""
SCHEMA = Path(__file__).parents[1] / "schemas" / "metrics.schema.json"
_RATIOS = {"packets": "packets", "size": "size_bytes", "mission": "mission_s"}


def measure_series(series: Series) -> dict[str, Any]:
    """Metrics of every attempt; written to `metrics.json`. Raises ResultsError for a series that mixes conditions."""
    attempts = series.attempts()
    manifests = [attempt.manifest() for attempt in attempts]
    first = manifests[0]
    for attempt, manifest in zip(attempts, manifests, strict=True):
        for name in ("experiment", "arm", "profile", "shaper"):
            if manifest[name] != first[name]:
                raise ResultsError(f"{attempt.path}: {name} is {manifest[name]}, in the first attempt {first[name]}")
    document: dict[str, Any] = {
        "version": METRICS_VERSION,
        **{name: first[name] for name in ("experiment", "arm", "profile")},
        "revision": common_revision(manifests),
        "shaper": first["shaper"],
        "protocols": {},
        "ratios": {},
        "statistics": {},
        "notes": [],
    }
    for attempt, manifest in zip(attempts, manifests, strict=True):
        side = document["protocols"].setdefault(attempt.protocol, {"attempts": [], "void": []})
        measured = measure_attempt(attempt, manifest)
        if measured["status"] == "void":
            side["void"].append({"attempt": attempt.number, "reason": measured["reason"]})
        else:
            side["attempts"].append(measured)
    document["ratios"] = ratios(document["protocols"])
    document["statistics"] = statistics(document["protocols"])
    try:
        jsonschema.validate(document, json.loads(SCHEMA.read_text(encoding="utf-8")))
    except jsonschema.ValidationError as error:
        raise ResultsError(
            f"{series.path}: its metrics break their schema: {error.json_path}: {error.message}"
        ) from error
    write_json(series.path / METRICS, document)
    return document


def ratios(protocols: dict[str, Any]) -> dict[str, float]:
    """MAVLink's medians over MQTT-XT's, of completed attempts; empty where one side has none."""
    completed = {
        name: [
            attempt for attempt in protocols.get(name, {"attempts": []})["attempts"] if attempt["status"] == "completed"
        ]
        for name in ("mavlink", "mqttxt")
    }
    if not all(completed.values()):
        return {}
    found = {}
    for ratio, field in _RATIOS.items():
        above, below = (median(attempt[field] for attempt in completed[name]) for name in ("mavlink", "mqttxt"))
        if below:
            found[ratio] = round(above / below, 4)
    return found
