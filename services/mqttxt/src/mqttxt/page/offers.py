"""The commands that the page offers, with units and limits, and the reading of a page's requests.

Disarming and anything forced are not offered.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields
from typing import Any

from ..core.clock import MAX_TTL_MS
from ..errors import ConfigurationError
from ..protocol.codec import layout_of
from ..protocol.commands import BROADCASTABLE, Arm, Command, Goto, Hold, Land, Pause, Return, Takeoff
from ..protocol.names import MAX_DRONE, parse_in_fleet
from ..protocol.topics import SELECTABLE
from ..station.plan import Plan
from ..station.views import TTL_S, UPLOAD_TTL_S

OFFERED: dict[str, type[Command]] = {cls.name: cls for cls in (Arm, Takeoff, Goto, Hold, Land, Return, Pause)}
LONGEST_TTL_S = MAX_TTL_MS / 1000
MOST_AHEAD_MS = 100.0
"""How far a page's time may be ahead of the program's: its clock has a limited resolution."""
MOST_LISTED = 2500
"""Drones or fogs of one request: those of ten fleets."""
MOST_NAME = 100
LINK_FIGURES = ("rate", "delay", "loss")
_LABELS = {"altitude_m": "Height"}
"""Labels of fields that the page calls by another name."""
_UNITS = {"_m": "metres above home", "_deg": "degrees"}

FogKey = tuple[str, int]
"""The name of the fleet, empty for a single fleet, and the fog's number."""
DroneKey = tuple[str, int, int]
"""The same and the drone's number."""


@dataclass(frozen=True)
class Target:
    """The addressees of a request: single `drones`, every drone of `fogs`, or only the `best` of these fogs."""

    drones: tuple[DroneKey, ...] = ()
    fogs: tuple[FogKey, ...] = ()
    best: bool = False


@dataclass(frozen=True)
class CommandRequest:
    """Send `command` to `target`, to start within `ttl_s` seconds from now or not at all."""

    command: Command
    target: Target
    ttl_s: float


@dataclass(frozen=True)
class TakeOverRequest:
    """Take control of `drones` from any holder."""

    drones: tuple[DroneKey, ...]


@dataclass(frozen=True)
class UploadRequest:
    """Replace the plan of one drone by `plan`, which is from the file `name`, within `ttl_s` seconds or not at all."""

    plan: Plan
    name: str
    drone: DroneKey
    ttl_s: float = UPLOAD_TTL_S


@dataclass(frozen=True)
class LookRequest:
    """Show `plan` without sending anything."""

    plan: Plan


@dataclass(frozen=True)
class MissionRequest:
    """Fly the mission that this page has uploaded to one drone, from its start, or `resume` it."""

    drone: DroneKey
    resume: bool
    ttl_s: float = TTL_S


@dataclass(frozen=True)
class LinkRequest:
    """Change the link `name`, as `Links.change` does, or put it `back` to its plan."""

    name: str
    figures: Mapping[str, str]
    closed: bool = False
    back: bool = False


Request = CommandRequest | TakeOverRequest | UploadRequest | MissionRequest


def catalogue() -> dict[str, Any]:
    """Every offered command: its parameters with unit, limits and default, and its possible addressees."""
    return {
        name: {
            "limit_s": cls.limit_s,
            "each": not issubclass(cls, BROADCASTABLE),
            "best": name in SELECTABLE,
            "parameters": [_parameter(cls, field.name, field.mark) for field in layout_of(cls).fields],
        }
        for name, cls in OFFERED.items()
    }


def read_request(text: str, now_ms: float) -> tuple[int, Request | LinkRequest | LookRequest]:
    """Read a page's request and its number; raises ConfigurationError that names field, value and expectation.

    `now_ms` is the time that updates give to pages, in ms. The time limit of a request that moves a drone,
    replaces its plan or takes control begins at its `at_ms`, when the user asked: a request that was delayed on its
    way has less time left.
    """
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        raise ConfigurationError("request: expected JSON") from None
    if not isinstance(found, dict):
        raise ConfigurationError(f"request: expected an object, got {type(found).__name__}")
    number = _whole(found.get("number"), "number", 2**53)
    what = found.get("do")
    if what == "link":
        return number, _link(found)
    if what == "look":
        return number, LookRequest(_plan(found)[1])
    target = _target(found.get("to"))
    if what == "take_over":
        if not target.drones:
            raise ConfigurationError("to: expected drones to take control of")
        _left_s(found, TTL_S, now_ms)
        return number, TakeOverRequest(target.drones)
    if what == "upload":
        drone = _one_drone(target, "upload")
        name, plan = _plan(found)
        return number, UploadRequest(plan, name, drone, _left_s(found, UPLOAD_TTL_S, now_ms))
    if what in ("start", "resume"):
        drone = _one_drone(target, f"{what} mission")
        return number, MissionRequest(drone, what == "resume", _left_s(found, TTL_S, now_ms))
    if what != "command":
        raise ConfigurationError(f"do {_shown(what)}: expected command, take_over, upload, look, start, resume or link")
    command = _command(found.get("command"), found.get("parameters", {}))
    _check_target(command, target)
    ttl_s = _number(found.get("ttl_s", TTL_S), "ttl_s", 0.1, LONGEST_TTL_S)
    return number, CommandRequest(command, target, _left_s(found, ttl_s, now_ms))


def _left_s(found: dict[str, Any], ttl_s: float, now_ms: float) -> float:
    """The seconds that are left of a time limit that began when the user asked."""
    late_s = (now_ms - _number(found.get("at_ms"), "at_ms", 0, now_ms + MOST_AHEAD_MS)) / 1000
    if late_s >= ttl_s:
        what = found["command"] if found["do"] == "command" else found["do"]
        raise ConfigurationError(
            f"not sent: it was asked for {late_s:.1f} s before it came to the page's program; "
            f"expected less than {ttl_s:g} s for {what}"
        )
    return min(ttl_s, ttl_s - late_s)


def _parameter(cls: type[Any], name: str, mark: Any) -> dict[str, Any]:
    default = next(field.default for field in fields(cls) if field.name == name)
    quantity, _, _ = name.rpartition("_")
    return {
        "name": name,
        "label": _LABELS.get(name, quantity.capitalize()),
        "unit": next(unit for ending, unit in _UNITS.items() if name.endswith(ending)),
        "low": mark.low,
        "high": mark.high,
        "default": None if default is MISSING else default,
    }


def _plan(found: dict[str, Any]) -> tuple[str, Plan]:
    """A file's name, and the plan in its text."""
    name, text = found.get("name"), found.get("text")
    if not isinstance(name, str) or not 0 < len(name) <= MOST_NAME:
        raise ConfigurationError(f"name {_shown(name)}: expected 1 to {MOST_NAME} characters")
    if not isinstance(text, str):
        raise ConfigurationError(f"text {_shown(text)}: expected the text of a .plan file")
    return name, Plan.parse(text, name)


def _link(found: dict[str, Any]) -> LinkRequest:
    name, figures = found.get("link"), found.get("figures", {})
    closed, back = found.get("closed", False), found.get("back", False)
    if not isinstance(name, str) or not 0 < len(name) <= MOST_NAME:
        raise ConfigurationError(f"link {_shown(name)}: expected 1 to {MOST_NAME} characters")
    is_text = isinstance(figures, dict) and all(isinstance(text, str) for text in figures.values())
    if not isinstance(figures, dict) or not is_text or not set(figures) <= set(LINK_FIGURES):
        raise ConfigurationError(f"figures {_shown(figures)}: expected texts of {', '.join(LINK_FIGURES)}")
    if not isinstance(closed, bool) or not isinstance(back, bool):
        raise ConfigurationError(f"closed {_shown(closed)}, back {_shown(back)}: expected true or false")
    return LinkRequest(name, figures, closed, back)


def _one_drone(target: Target, what: str) -> DroneKey:
    if len(target.drones) != 1:
        raise ConfigurationError(f"{what}: expected one drone, because each needs a way of its own")
    return target.drones[0]


def _command(name: object, parameters: object) -> Command:
    cls: type[Any] | None = OFFERED.get(name) if isinstance(name, str) else None
    if cls is None:
        raise ConfigurationError(f"command {_shown(name)}: expected one of {', '.join(OFFERED)}")
    marks = {field.name: field.mark for field in layout_of(cls).fields}
    if not isinstance(parameters, Mapping) or set(parameters) != set(marks):
        raise ConfigurationError(f"{name} parameters: expected {', '.join(marks) or 'none'}")
    values = {
        field: _number(parameters[field], f"{name} {field}", mark.low, mark.high) for field, mark in marks.items()
    }
    command: Command = cls(**values)
    return command


def _target(found: object) -> Target:
    kinds = {"drones", "fogs", "best"}
    if not isinstance(found, dict) or len(found) != 1 or not set(found) <= kinds:
        raise ConfigurationError("to: expected one of drones, fogs, best")
    ((kind, listed),) = found.items()
    if not isinstance(listed, list) or not 0 < len(listed) <= MOST_LISTED:
        raise ConfigurationError(f"to {kind}: expected a list of 1 to {MOST_LISTED}")
    if kind != "drones":
        fogs = tuple(dict.fromkeys(_fog(fog) for fog in listed))
        return Target(fogs=fogs, best=kind == "best")
    if not all(isinstance(pair, list) and len(pair) == 2 for pair in listed):
        raise ConfigurationError("to drones: expected pairs of a fog and a drone's number")
    pairs = ((*_fog(fog), _whole(drone, "to drone", MAX_DRONE)) for fog, drone in listed)
    return Target(drones=tuple(dict.fromkeys(pairs)))


def _fog(value: object) -> FogKey:
    """A fog as pages name it: by number, or among several fleets by a text such as `acme/1`."""
    return parse_in_fleet("to fog", value) if isinstance(value, str) else ("", _whole(value, "to fog", 2**16))


def _check_target(command: Command, target: Target) -> None:
    """Check that a command suits its addressees: positions need one drone each, a choice a command that PSMI ranks."""
    if target.best:
        if command.name not in SELECTABLE:
            raise ConfigurationError(f"{command.name}: expected {', '.join(SELECTABLE)} to whoever arrives first")
    elif not isinstance(command, BROADCASTABLE) and len(target.drones) != 1:
        raise ConfigurationError(f"{command.name}: expected one drone, because each needs a place of its own")


def _number(value: object, what: str, low: float, high: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise ConfigurationError(f"{what} {_shown(value)}: expected a number from {low:g} to {high:g}")
    return float(value)


def _whole(value: object, what: str, most: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= most:
        raise ConfigurationError(f"{what} {_shown(value)}: expected a whole number from 1 to {most}")
    return value


def _shown(value: object) -> str:
    """A request's value for an error, cut to fit a line."""
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
