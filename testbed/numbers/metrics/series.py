"""Metrics of a series: the numbers of every attempt and their statistics, written to `metrics.json`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, cast

import jsonschema

from ...errors import ResultsError
from ...fly.observations import verdict_of
from ...fly.results import METRICS, Attempt, Series, read_json, write_json
from ...fly.validity import Verdict, paired, unmeasured, unread
from ..attempt_entry import AttemptEntry
from ..observed import observe
from ..quantities import ratios, statistics
from ..written import Metrics, SideEntry, VoidEntry
from .attempt import NOT_FLOWN, measure_attempt
from .conditions import Flown, check_same, common_machine, common_revision, differences
from .shaping import read_shaping

METRICS_VERSION = 2
"""Raised when a field is removed or changes its meaning; new fields do not raise it."""
SCHEMA = Path(__file__).parents[1] / "schemas" / "metrics.schema.json"


def measure_series(series: Series) -> Metrics:
    """Measure every attempt of a series and write `metrics.json`.

    An attempt that cannot be read is void, for that reason. Raises ResultsError if the series mixes conditions, or if
    none of its attempts can be read.
    """
    flown, unreadable = _manifests(series)
    shapings = [read_shaping(attempt) for attempt, _ in flown]
    check_same(flown, shapings)
    _, first = flown[0]
    revision, machine, notes = common_revision(flown), common_machine(flown), differences(flown)
    protocols: dict[str, SideEntry] = {}
    loads = {attempt: manifest["host"]["load_after"] for attempt, manifest in flown if "load_after" in manifest["host"]}
    verdicts, entries = _measure(series, flown, unreadable)
    for attempt in series.attempts():
        side = protocols.setdefault(attempt.protocol, {"attempts": [], "void": []})
        if verdicts[attempt].is_void:
            side["void"].append(_void(attempt, verdicts[attempt], loads.get(attempt)))
        else:
            side["attempts"].append(entries[attempt])
    sides = observe(protocols)
    document: Metrics = {
        "version": METRICS_VERSION,
        "experiment": first["experiment"],
        "arm": first["arm"],
        "profile": first["profile"],
        "revision": revision,
        "machine": machine,
        "shaper": first["shaper"],
        "protocols": protocols,
        "ratios": ratios(sides),
        "statistics": statistics(sides),
        "notes": notes,
    }
    error = schema_error(document)
    if error is not None:
        raise ResultsError(f"{series.path}: its metrics break their schema: {error}")
    write_json(series.path / METRICS, document)
    return document


def read_metrics(series: Series) -> Metrics:
    """Read `metrics.json`; measure the series if it has none. Raises ResultsError if another version made the file."""
    path = series.path / METRICS
    if not path.exists():
        return measure_series(series)
    document = read_json(path)
    error = schema_error(document)
    if error is not None:
        raise ResultsError(f"{path}: made by another version ({error}); type: testbed report {series.path}")
    return cast("Metrics", document)


def schema_error(document: Mapping[str, Any]) -> str | None:
    """Where and how a document breaks the schema of `metrics.json`; None if it does not."""
    error = jsonschema.exceptions.best_match(_validator().iter_errors(document))
    return None if error is None else f"{error.json_path}: {error.message[:200]}"


@cache
def _validator() -> jsonschema.Draft202012Validator:
    schema = json.loads(SCHEMA.read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(_without_references(schema, schema["$defs"]))


def _without_references(part: Any, definitions: dict[str, Any]) -> Any:
    """The schema with each definition where it is referred to: looking them up took half of the validator's time."""
    if isinstance(part, list):
        return [_without_references(one, definitions) for one in part]
    if not isinstance(part, dict):
        return part
    if "$ref" in part:
        return _without_references(definitions[part["$ref"].removeprefix("#/$defs/")], definitions)
    return {name: _without_references(one, definitions) for name, one in part.items() if name != "$defs"}


def _manifests(series: Series) -> tuple[list[Flown], dict[Attempt, str]]:
    """The attempts whose manifests can be read, and the reasons why the others' cannot."""
    flown: list[Flown] = []
    errors: dict[Attempt, ResultsError] = {}
    for attempt in series.attempts():
        try:
            flown.append((attempt, attempt.manifest()))
        except ResultsError as error:
            errors[attempt] = error
    if not flown:
        raise next(iter(errors.values()))
    return flown, {attempt: _relative(series, error) for attempt, error in errors.items()}


def _measure(
    series: Series, flown: list[Flown], unreadable: dict[Attempt, str]
) -> tuple[dict[Attempt, Verdict], dict[Attempt, AttemptEntry]]:
    """Every attempt's verdict, and the entry of each that counts. Raises ResultsError where none can be measured."""
    verdicts = {attempt: verdict_of(attempt, manifest) for attempt, manifest in flown}
    verdicts |= {attempt: unread(reason) for attempt, reason in unreadable.items()}
    entries: dict[Attempt, AttemptEntry] = {}
    broken: list[ResultsError] = []
    for attempt, manifest in flown:
        if paired(verdicts)[attempt].is_void:
            continue
        try:
            entries[attempt] = measure_attempt(attempt, manifest, verdicts[attempt])
        except ResultsError as error:
            broken.append(error)
            reason = _relative(series, error)
            verdicts[attempt] = unmeasured(verdicts[attempt], reason)
            entries[attempt] = _without_numbers(attempt, manifest, verdicts[attempt], reason)
    if len(broken) == len(flown):
        raise broken[0]
    return paired(verdicts), entries


def _void(attempt: Attempt, verdict: Verdict, load: float | None) -> VoidEntry:
    repeat = {"repeat": attempt.repeat} if attempt.repeat else {}
    at_its_end = {"load": load} if load is not None else {}
    return cast("VoidEntry", {"attempt": attempt.number, **repeat, "reason": verdict.reason, **at_its_end})


def _without_numbers(attempt: Attempt, manifest: dict[str, Any], verdict: Verdict, note: str) -> AttemptEntry:
    return {
        "attempt": attempt.number,
        "repeat": attempt.repeat,
        "status": verdict.status,
        "reason": verdict.reason,
        "mission_s": None,
        **NOT_FLOWN,
        "notes": [note],
        "outcomes": {},
        "links_measured": {},
        "cpu_s": manifest.get("cpu_s", {}),
        "memory_bytes": manifest.get("memory_bytes", {}),
    }


def _relative(series: Series, error: ResultsError) -> str:
    """The error's text with paths relative to the series, so that it does not depend on where that is."""
    return str(error).replace(f"{series.path}/", "")
