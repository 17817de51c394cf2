"""What `from mqttxt import …` gives: every name says what it is, with its parameters, their units and its errors."""

from __future__ import annotations

import builtins
import dataclasses
import inspect
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import mqttxt
from mqttxt import Drone, Fleets, Fog, GroundStation, SentCommand

UNITS = ("_deg", "_m", "_m_s", "_s", "_ms", "_pct", "_hz")
"""A field that ends in one of these has said what it is counted in."""
CLASSES = {name: found for name in mqttxt.__all__ if inspect.isclass(found := getattr(mqttxt, name))}
DOORS: dict[str, type[Any]] = {
    "GroundStation": GroundStation,
    "Fleets": Fleets,
    "Fog": Fog,
    "Drone": Drone,
}
"""The classes whose methods a program calls."""
PUBLIC = {
    "GroundStation": {
        "best",
        "broker",
        "connect",
        "drone",
        "drones",
        "events",
        "fog",
        "fogs",
        "name",
        "prefix",
        "reload",
        "session",
        "share_list",
        "take_over",
        "wait_until",
    },
    "Fleets": {
        *("best", "connect", "drone", "drones", "events", "fog", "fogs", "name", "reload", "stations", "wait_until"),
    },
    "Fog": {"best", "broadcast", "drone", "drones", "fleet", "is_live", "number", "ranking", "take_over"},
    "Drone": {
        *("arm", "claim", "disarm", "release", "goto", "hold", "land", "return_home", "send", "takeoff", "take_over"),
        *("clear_plan", "download", "pause", "resume", "set_current_item", "start_mission", "upload"),
        *("parameters", "set_parameter", "logs", "download_log"),
        *(
            "fleet",
            "fog",
            "holder",
            "is_controlled",
            "number",
            "is_reachable",
            "location",
            "prefix",
            "readings",
            "state",
            "states",
        ),
    },
    "SentCommand": set(),
}


def own(cls: type[Any]) -> dict[str, Any]:
    return {name: getattr(cls, name) for name in dir(cls) if not name.startswith("_")}


def methods() -> dict[str, tuple[type[Any], Callable[..., Any]]]:
    return {
        f"{name}.{method}": (cls, found)
        for name, cls in DOORS.items()
        for method, found in own(cls).items()
        if inspect.isfunction(found)
    }


def names(text: str, heading: str) -> set[str]:
    """What a section of a docstring lists: `name: …`, or several names before the colon."""
    section = re.search(rf"^( *){heading}:\n((?:\1 +.*\n?|\n)+)", inspect.cleandoc(text), re.MULTILINE)
    lines = section[2].splitlines() if section else []
    listed = [line.split(":")[0] for line in lines if re.match(r" {4}\w+(, \w+)*:", line)]
    return {name.strip() for entry in listed for name in entry.split(",")}


@pytest.mark.parametrize("name", CLASSES)
def test_every_class_says_what_it_is(name: str) -> None:
    text = CLASSES[name].__doc__ or ""
    assert re.match(r"[A-Z]", text), f"{name}: no docstring of its own"
    assert not text.startswith(f"{name}("), f"{name}: the docstring is the dataclass's own"


@pytest.mark.parametrize("name", [name for name, cls in CLASSES.items() if dataclasses.is_dataclass(cls)])
def test_every_field_has_a_unit_in_its_name_or_is_named_by_its_class(name: str) -> None:
    cls = CLASSES[name]
    unsaid = [
        field.name
        for field in dataclasses.fields(cls)
        if not field.name.endswith(UNITS) and not re.search(rf"\b{field.name}\b", cls.__doc__ or "")
    ]
    assert not unsaid, f"{name}: say what {', '.join(unsaid)} is"


@pytest.mark.parametrize("name", [*methods(), *DOORS])
def test_every_parameter_is_named_where_it_is_given(name: str) -> None:
    cls, function = methods().get(name, (DOORS.get(name), None))
    assert cls is not None
    if function is None and cls not in (GroundStation, Fleets):
        return  # a fog and a drone are made by their station
    text = (cls.__doc__ or "") + "\n" + ((function.__doc__ if function else None) or "")
    parameters = set(inspect.signature(function or cls).parameters) - {"self"}
    own_text = (function.__doc__ if function else cls.__doc__) or ""
    listed = names(cls.__doc__ or "", "Parameters") | names(own_text, "Parameters") | set(re.findall(r"`(\w+)`", text))
    assert parameters <= listed, f"{name}: say what {', '.join(sorted(parameters - listed))} is"


@pytest.mark.parametrize("name", [*methods(), "GroundStation", "Fleets"])
def test_every_error_is_named_and_is_one(name: str) -> None:
    cls, function = methods().get(name, (DOORS.get(name, GroundStation), None))
    own_text = (function.__doc__ if function else cls.__doc__) or ""
    raised = names(own_text, "Raises") or (names(cls.__doc__ or "", "Raises") if cls is Drone else set())
    if not raised:
        assert re.search(r"Raises nothing|errors as `Fog\.take_over`", own_text), f"{name}: say what it raises"
    for error in raised:
        found = getattr(mqttxt, error, None) or getattr(builtins, error, None)
        assert isinstance(found, type), error
        assert issubclass(found, Exception), error


@pytest.mark.parametrize("name", DOORS)
def test_every_property_says_what_it_is(name: str) -> None:
    unsaid = [key for key, found in own(DOORS[name]).items() if isinstance(found, property) and not found.__doc__]
    assert unsaid == []


@pytest.mark.parametrize("name", PUBLIC)
def test_nothing_of_what_runs_it_shows(name: str) -> None:
    cls = SentCommand if name == "SentCommand" else DOORS[name]
    shown = {attribute for attribute in dir(cls) if not attribute.startswith("_")}
    assert shown == PUBLIC[name]


def test_every_name_is_on_the_api_page() -> None:
    page = (Path(__file__).resolve().parents[3] / "docs" / "api.md").read_text(encoding="utf-8")
    unsaid = [name for name in mqttxt.__all__ if not re.search(rf"`[^`]*\b{name}\b[^`]*`", page)]
    assert unsaid == []
