"""A profile's file and those it inherits from: YAML, checked against the schema, every figure with its source."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from net.link_plan import DIRECTIONS

from ...errors import UserError
from ..documents import ROOT, read_document, shown
from . import units

FOLDER = ROOT / "tc_profiles"
SCHEMA_FILE = FOLDER / "profile.schema.json"

PARSERS: dict[str, tuple[str, Callable[[str], Any]]] = {
    "rate": ("rate_bps", units.parse_rate_bps),
    "queue": ("queue_packets", units.parse_packets),
    "delay": ("delay_us", units.parse_delay_us),
    "jitter": ("jitter_us", units.parse_delay_us),
    "loss": ("loss", units.parse_share),
    "duplicate": ("duplicate", units.parse_share),
    "corrupt": ("corrupt", units.parse_share),
    "reorder": ("reorder", units.parse_share),
}
"""Fields with a unit: their name in a plan, and their parser; all other fields are the same in both."""


OFTEN_US = 100_000
"""The least time, on average, from one of an event's occurrences to the next: a plan has all those of a flight."""


@dataclass(frozen=True)
class ProfileFigure:
    """One figure, in the unit of the plan's field; `where` is file and field, for errors."""

    value: Any
    source: str
    where: str
    text: str


@dataclass(frozen=True)
class ProfileEntry:
    """A file's entry of a class or link: figures by (direction, plan's field), and whether directions share a rate."""

    figures: Mapping[tuple[str, str], ProfileFigure]
    shared: ProfileFigure | None


@dataclass(frozen=True)
class EventRule:
    """An event of the file. Exactly one of `at_us`, `every_us` and `share` (of time, in bursts) is set.

    `for_us` is None for bursts, which last from `shortest_us` to `longest_us`, and for an event until the end.
    """

    link: str
    where: str
    change: Mapping[str, ProfileFigure]
    source: str
    at_us: int | None = None
    every_us: int | None = None
    for_us: int | None = None
    share: float | None = None
    shortest_us: int = 0
    longest_us: int = 0


@dataclass(frozen=True)
class Layer:
    """One file: classes, single links, and events (None if it has no such section)."""

    file: str
    classes: Mapping[str, ProfileEntry]
    overrides: Mapping[str, ProfileEntry]
    events: tuple[EventRule, ...] | None


@dataclass(frozen=True)
class Profile:
    """A profile with all files that it inherits from; the first layer is the most distant one."""

    name: str
    description: str
    layers: tuple[Layer, ...]

    @property
    def rules(self) -> tuple[EventRule, ...]:
        """The events of the nearest file that has the section."""
        return next((layer.events for layer in reversed(self.layers) if layer.events is not None), ())


def profile_names(folder: Path = FOLDER) -> list[str]:
    """The available profiles, `ideal` first, then by name."""
    return sorted((path.stem for path in folder.glob("*.yaml")), key=lambda name: (name != "ideal", name))


def read_profile(name: str, folder: Path = FOLDER) -> Profile:
    """Read the profile with a name in the folder, or a file by its path, as `my/own.yaml`.

    Raises UserError that names file, field, value and what was expected.
    """
    path = Path(name) if name.endswith(".yaml") else folder / f"{name}.yaml"
    if not path.is_file():
        known = ", ".join(profile_names(folder))
        raise UserError(f"PROFILE={name}: expected one of {known}, or the path of a .yaml file")
    own = folder / path.name
    if own.is_file() and not own.samefile(path):
        raise UserError(f"PROFILE={name}: {path.stem} is another profile; expected a file with a name of its own")
    layers: list[Layer] = []
    seen: list[Path] = []
    description = ""
    while True:
        seen.append(path.resolve())
        document = read_document(path, SCHEMA_FILE)
        description = description or document["description"]
        layers.insert(0, _layer(document, shown(path)))
        parent = document.get("inherits")
        if parent is None:
            return Profile(Path(name).stem, description, tuple(layers))
        here = f"{shown(path)}: inherits: {parent!r}"
        beside = path.parent / f"{parent}.yaml"
        path = beside if beside.is_file() else folder / f"{parent}.yaml"
        if not path.is_file():
            raise UserError(f"{here}: expected one of {', '.join(profile_names(folder))}")
        if path.resolve() in seen:
            circle = " > ".join([*(step.stem for step in seen), parent])
            raise UserError(f"{here}: expected a profile that does not come back to this one ({circle})")


def _layer(document: dict[str, Any], file: str) -> Layer:
    sections = [document.get("links", {}), document.get("overrides", {})]
    classes, overrides = (
        {name: _entry(entry, file, f"{section}.{name}") for name, entry in content.items()}
        for section, content in zip(("links", "overrides"), sections, strict=True)
    )
    events = None
    if "events" in document:
        events = tuple(_rule(rule, f"{file}: events[{number}]") for number, rule in enumerate(document["events"]))
    return Layer(file, classes, overrides, events)


def _entry(entry: dict[str, Any], file: str, field: str) -> ProfileEntry:
    """Read an entry: `both` counts for each direction, and a direction's own figures override it."""
    figures: dict[tuple[str, str], ProfileFigure] = {}
    for key in ("both", *DIRECTIONS):
        if key in entry:
            for name, figure in _figures(entry[key], f"{file}: {field}.{key}"):
                figures |= {(direction, name): figure for direction in (DIRECTIONS if key == "both" else (key,))}
    shared = None
    if "shared" in entry:
        shared = ProfileFigure(entry["shared"], "", f"{file}: {field}.shared", str(entry["shared"]).lower())
    return ProfileEntry(figures, shared)


def _figures(block: dict[str, Any], where: str) -> Iterator[tuple[str, ProfileFigure]]:
    sources = block["source"]
    for name, text in block.items():
        if name == "source":
            continue
        source = sources if isinstance(sources, str) else sources.get(name)
        if source is None:
            raise UserError(f"{where}.source.{name}: missing: expected text that says where {text!r} comes from")
        yield read_figure(name, text, source, f"{where}.{name}")


def read_figure(name: str, text: Any, source: str, where: str) -> tuple[str, ProfileFigure]:
    """The plan's field and the figure. Raises UserError if it cannot be read."""
    field, parse = PARSERS.get(name, (name, None))
    value = text if parse is None else _parsed(parse, text, where)
    return field, ProfileFigure(value, source, where, str(text))


def _parsed(parse: Callable[[str], Any], text: str, where: str) -> Any:
    try:
        return parse(text)
    except ValueError as error:
        raise UserError(f"{where}: {text!r}: expected {error}") from error


def _rule(rule: dict[str, Any], where: str) -> EventRule:
    kinds = [kind for kind in ("at", "every", "bursts") if kind in rule]
    if len(kinds) != 1:
        raise UserError(f"{where}: {' and '.join(kinds) or 'no time'}: expected one of at, every, bursts")
    kind = kinds[0]
    if kind == "every" and "for" not in rule:
        raise UserError(f"{where}.for: missing: expected how long it lasts, as 500ms")
    if kind == "bursts" and "for" in rule:
        raise UserError(f"{where}.for: {rule['for']!r}: expected none beside bursts, which have shortest and longest")
    change = dict(
        read_figure(name, text, rule["source"], f"{where}.change.{name}") for name, text in rule["change"].items()
    )
    times = {
        name: _parsed(units.parse_time_us, rule[name], f"{where}.{name}")
        for name in ("at", "every", "for")
        if name in rule
    }
    if 0 < times.get("every", OFTEN_US) < OFTEN_US:
        raise UserError(f"{where}.every: {rule['every']!r}: expected at least {units.show_time(OFTEN_US)}")
    for name, limit in (("every", None), ("for", times.get("every"))):
        if name in times and (times[name] == 0 or (limit is not None and times[name] >= limit)):
            expected = f"shorter than every, {rule['every']}" if limit is not None and times[name] else "more than 0"
            raise UserError(f"{where}.{name}: {rule[name]!r}: expected {expected}")
    if kind != "bursts":
        return EventRule(
            rule["link"], where, change, rule["source"], times.get("at"), times.get("every"), times.get("for")
        )
    return _bursts(rule, where, change)


def _bursts(rule: dict[str, Any], where: str, change: Mapping[str, ProfileFigure]) -> EventRule:
    bursts = rule["bursts"]
    share = _parsed(units.parse_share, bursts["share"], f"{where}.bursts.share")
    shortest, longest = (
        _parsed(units.parse_delay_us, bursts[name], f"{where}.bursts.{name}") for name in ("shortest", "longest")
    )
    if not 0 < share <= 0.9:
        raise UserError(f"{where}.bursts.share: {bursts['share']!r}: expected a share of time above 0%, at most 90%")
    if shortest < 1_000:
        raise UserError(f"{where}.bursts.shortest: {bursts['shortest']!r}: expected at least 1ms")
    if longest < shortest:
        raise UserError(f"{where}.bursts.longest: {bursts['longest']!r}: expected at least {bursts['shortest']}")
    if (shortest + longest) / 2 < share * OFTEN_US:
        expected = f"a burst every {units.show_time(OFTEN_US)} on average, or longer ones"
        raise UserError(f"{where}.bursts.share: {bursts['share']!r}: expected at most {expected}")
    return EventRule(rule["link"], where, change, rule["source"], None, None, None, share, shortest, longest)
