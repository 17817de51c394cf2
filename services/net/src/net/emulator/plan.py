"""The plan of a run, read from JSON and checked field by field: the settings of every directed link, and the events."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, TypeGuard

from ..interfaces import NetError
from ..link_plan import DISTRIBUTIONS, VERSION, BaseLinksPlan, EventPlan, LinkPlan

MAX_DELAY_US = 60_000_000
MAX_QUEUE_PACKETS = 1_000_000
MIN_RATE_BPS, MAX_RATE_BPS = 1_000, 100_000_000_000
MAX_TIME_S = 86_400.0
MAX_SEED = 2**64 - 1
_BOUNDS: dict[str, tuple[int, int]] = {
    "rate_bps": (MIN_RATE_BPS, MAX_RATE_BPS),
    "queue_packets": (1, MAX_QUEUE_PACKETS),
    "delay_us": (0, MAX_DELAY_US),
    "jitter_us": (0, MAX_DELAY_US),
}
_SHARES = ("loss", "duplicate", "corrupt", "reorder")
_FLAGS = ("reordering", "closed")


class PlanError(NetError):
    """The plan cannot be carried out; the text names file, field, value and what was expected."""


@dataclass(frozen=True)
class Settings(LinkPlan):
    """The settings of a directed link at a time; `closed`, which only events set, lets nothing through."""

    closed: bool = False


@dataclass(frozen=True)
class ShapedPlan(BaseLinksPlan):
    """A checked plan."""

    links: Mapping[str, Settings]


def read_plan(path: Path) -> ShapedPlan:
    """Read a file with a plan, or with a plan in its field `plan`, as a run's file has it. Raises PlanError."""
    data = read_json(path)
    if isinstance(data, dict) and "plan" in data:
        return parse_plan(data["plan"], f"{path}: plan")
    return parse_plan(data, str(path))


def read_json(path: Path) -> object:
    """Read a file's JSON. Raises PlanError."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise PlanError(f"{path}: {error.strerror}; expected a plan in JSON") from error
    except ValueError as error:
        raise PlanError(f"{path}: {error}; expected a plan in JSON") from error


def parse_plan(data: object, source: str) -> ShapedPlan:
    """Check a plan in parsed JSON. Raises PlanError that begins with `source`."""
    top = mapping(data, source, ("version", "profile", "seed", "links", "events"))
    if top.get("version") != VERSION:
        raise wrong(f"{source}: version", top.get("version"), f"{VERSION}")
    profile = top.get("profile")
    if not isinstance(profile, str):
        raise wrong(f"{source}: profile", profile, "a name")
    seed = top.get("seed")
    if not _is_integer(seed) or not 0 <= seed <= MAX_SEED:
        raise wrong(f"{source}: seed", seed, f"a whole number from 0 to {MAX_SEED}")
    listed = mapping(top.get("links"), f"{source}: links", None)
    if not listed:
        raise wrong(f"{source}: links", listed, "at least one")
    links = {name: _link(value, f"{source}: links.{name}") for name, value in listed.items()}
    for name, link in links.items():
        _check_partner(name, link, links, f"{source}: links.{name}.shared_with")
    found = top.get("events", [])
    if not isinstance(found, list):
        raise wrong(f"{source}: events", found, "a list")
    events = [_event(value, links, f"{source}: events[{number}]") for number, value in enumerate(found)]
    return ShapedPlan(profile, seed, links, tuple(sorted(events, key=lambda event: event.at_s)))


def changed(settings: Settings, change: Mapping[str, Any]) -> Settings:
    """The settings with the checked fields of a change."""
    return replace(settings, **change)


def _link(value: object, where: str) -> Settings:
    found = mapping(value, where, [field.name for field in fields(LinkPlan)])
    for name, given in found.items():
        _check_value(name, given, f"{where}.{name}")
    settings = Settings(**found)
    _check_together(settings, where)
    return settings


def _event(value: object, links: Mapping[str, Settings], where: str) -> EventPlan:
    found = mapping(value, where, ("at_s", "link", "for_s", "change"))
    for name in ("at_s", "for_s"):
        if not is_number(found.get(name)) or not 0 <= found[name] <= MAX_TIME_S:
            raise wrong(f"{where}.{name}", found.get(name), f"seconds from 0 to {MAX_TIME_S:g}")
    if found["for_s"] == 0:
        raise wrong(f"{where}.for_s", found["for_s"], "more than 0")
    link = found.get("link")
    change = parse_change(links, link, found.get("change"), where)
    return EventPlan(float(found["at_s"]), str(link), float(found["for_s"]), change)


def parse_change(links: Mapping[str, Settings], link: object, change: object, where: str) -> dict[str, Any]:
    """Check the fields of a link's change, as the plan's own. Raises PlanError."""
    if not isinstance(link, str) or link not in links:
        raise wrong(f"{where}.link", link, f"one of {', '.join(links)}")
    found = mapping(change, f"{where}.change", [one.name for one in fields(Settings) if one.name != "shared_with"])
    if not found:
        raise wrong(f"{where}.change", found, "at least one field of a link")
    for name, given in found.items():
        _check_value(name, given, f"{where}.change.{name}")
    _check_together(changed(links[link], found), f"{where}.change")
    return dict(found)


def _check_partner(name: str, link: Settings, links: Mapping[str, Settings], where: str) -> None:
    if link.shared_with is None:
        return
    partner = links.get(link.shared_with)
    if partner is None or link.shared_with == name or partner.shared_with not in (None, name):
        raise wrong(where, link.shared_with, "another link, which shares with no third one")
    if link.rate_bps is None or partner.rate_bps is None:
        raise wrong(where, link.shared_with, "a rate_bps on both: it is what they share")


def _check_value(name: str, value: object, where: str) -> None:
    if name in _BOUNDS:
        low, high = _BOUNDS[name]
        if value is None and name in ("rate_bps", "queue_packets"):
            return
        if not _is_integer(value) or not low <= value <= high:
            raise wrong(where, value, f"a whole number from {low} to {high}")
    elif name in _SHARES:
        if not is_number(value) or not 0 <= value <= 1:
            raise wrong(where, value, "a share from 0 to 1")
    elif name in _FLAGS:
        if not isinstance(value, bool):
            raise wrong(where, value, "true or false")
    elif name == "shared_with":
        if value is not None and not isinstance(value, str):
            raise wrong(where, value, "the name of a link, or null")
    elif value not in DISTRIBUTIONS:
        raise wrong(where, value, f"one of {', '.join(DISTRIBUTIONS)}")


def _check_together(settings: Settings, where: str) -> None:
    if settings.queue_packets is not None and settings.rate_bps is None:
        raise wrong(f"{where}.queue_packets", settings.queue_packets, "null without a rate_bps: nothing waits")
    if settings.reorder and not settings.delay_us:
        raise wrong(f"{where}.reorder", settings.reorder, "0 without a delay_us, which a frame skips")
    if settings.jitter_us > settings.delay_us:
        raise wrong(f"{where}.jitter_us", settings.jitter_us, f"at most delay_us, {settings.delay_us}")


def mapping(value: object, where: str, known: Sequence[str] | None) -> Mapping[str, Any]:
    """Check that a value is an object without fields other than `known`. Raises PlanError."""
    if not isinstance(value, dict):
        raise wrong(where, value, "an object")
    for name in value:
        if known is not None and name not in known:
            raise PlanError(f"{where}: unknown field {name!r}; expected {', '.join(known)}")
    return value


def _is_integer(value: object) -> TypeGuard[int]:
    return isinstance(value, int) and not isinstance(value, bool)


def is_number(value: object) -> TypeGuard[float]:
    """Whether a value is a finite number, and not a bool."""
    return _is_integer(value) or (isinstance(value, float) and math.isfinite(value))


def wrong(where: str, value: object, expected: str) -> PlanError:
    """An error in the common form: place, value, what was expected."""
    return PlanError(f"{where} {value!r}: expected {expected}")
