"""The conditions of a series: attempts that differ in the essential ones are refused, other differences are noted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ...errors import ResultsError
from ...fly.results import Attempt
from .shaping import Shaping

SAME = ("experiment", "arm", "profile", "shaper")
"""The fields of the manifest that must be the same in all attempts of a series."""

Flown = tuple[Attempt, dict[str, Any]]
"""An attempt and its manifest."""


def check_same(flown: Sequence[Flown], shapings: Sequence[Shaping]) -> None:
    """Raise ResultsError if a series mixes experiments, arms, profiles or shapers, or if its links' plans differ."""
    _, first = flown[0]
    plans = [shaping.conditions for shaping in shapings if shaping.conditions is not None]
    for (attempt, manifest), shaping in zip(flown, shapings, strict=True):
        for name in SAME:
            if manifest[name] != first[name]:
                raise ResultsError(f"{attempt.path}: {name} is {manifest[name]}, in the first attempt {first[name]}")
        if shaping.conditions not in (None, *plans[:1]):
            raise ResultsError(f"{attempt.path}: its links were planned otherwise than in the first attempt")


def common_revision(flown: Sequence[Flown]) -> str | None:
    """The commit at which all attempts were flown; None if they differ."""
    commits = {manifest["revision"].get("commit") for _, manifest in flown}
    return commits.pop() if len(commits) == 1 else None


def common_machine(flown: Sequence[Flown]) -> str | None:
    """The machine on which all attempts were flown; None if they differ or it is not recorded."""
    names = {manifest["host"].get("name") for _, manifest in flown}
    return names.pop() if len(names) == 1 else None


def differences(flown: Sequence[Flown]) -> list[str]:
    """One line for each condition that should be the same in all attempts and is not."""
    said = []
    commits = _told(flown, lambda manifest: manifest["revision"].get("commit"))
    if len(commits) > 1:
        said.append(f"flown at several revisions: {_listed(commits)}")
    dirty = [attempt for attempt, manifest in flown if manifest["revision"].get("dirty")]
    if dirty:
        said.append(f"flown with changes that are in no revision: {', '.join(map(_name, dirty))}")
    for field in ("name", "kernel", "machine"):
        values = _told(flown, lambda manifest, field=field: manifest["host"].get(field))
        if len(values) > 1:
            said.append(f"flown on several hosts: {field} {_listed(values)}")
    for protocol in sorted({attempt.protocol for attempt, _ in flown}):
        side = [one for one in flown if one[0].protocol == protocol]
        for key in sorted({key for _, manifest in side for key in manifest["configuration"]}):
            values = _told(side, lambda manifest, key=key: manifest["configuration"].get(key))
            if len(values) > 1:
                said.append(f"configured otherwise: {key} {_listed(values)}")
    return said


def _told(flown: Sequence[Flown], value: Any) -> dict[str, list[Attempt]]:
    """The attempts by a value of their manifests."""
    found: dict[str, list[Attempt]] = {}
    for attempt, manifest in flown:
        found.setdefault(str(value(manifest)), []).append(attempt)
    return found


def _listed(values: dict[str, list[Attempt]]) -> str:
    return "; ".join(f"{value} in {', '.join(map(_name, attempts))}" for value, attempts in sorted(values.items()))


def _name(attempt: Attempt) -> str:
    return f"{attempt.protocol} {attempt.number}"
