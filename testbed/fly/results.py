"""The results folder: the places of series and attempts, their files, and how these are read and written."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from ipaddress import IPv4Address
from pathlib import Path
from typing import Any
from uuid import uuid4

from ..errors import ResultsError, UserError
from ..plan.topology import Link, Node, Topology

METRICS = "metrics.json"
REPORT = "report.html"
MANIFEST_VERSION = 1
LINKS = "links"
KEY_LOG = "tls/keys.log"
"""The file for the session keys of the nodes' TLS connections, in the format of SSLKEYLOGFILE (RFC 9850)."""
FOLDERS = ("pcap", "sitl", "logs", "tls", LINKS)
"""The folders in an attempt's folder, to which the containers may write."""
LINKS_PLAN, LINKS_SHAPER, LINKS_CALIBRATION = "plan.json", "shaper.json", "calibration.json"
LINKS_COUNTERS, LINKS_EVENTS, LINKS_START = "counters.json", "events.jsonl", "start"
"""The files in the folder LINKS."""
_ATTEMPT = re.compile(r"attempt-(?P<number>\d\d)(-repeat-(?P<repeat>\d))?")
_MANIFEST_FIELDS: dict[str, type] = {
    **dict.fromkeys(("experiment", "arm", "profile", "status", "shaper"), str),
    **dict.fromkeys(("revision", "configuration", "host", "versions", "topology"), dict),
}

_NUMBER_OR_NONE = (int, type(None))
_CALLED: dict[str, type | tuple[type, ...]] = {"call": int, "command": str, "drone": _NUMBER_OR_NONE}
_EVENT_FIELDS: dict[str, dict[str, type | tuple[type, ...]]] = {
    "mission_start": {"scenario": str, "drones": list},
    "mission_end": {"status": str},
    "command": _CALLED | {"fog": _NUMBER_OR_NONE},
    "kind": {"name": str},
    "value": {"name": str},
    "kind_done": {"name": str, "missing": int},
    "outcome": _CALLED | {"word": str, "reason": (str, type(None)), "final": bool},
}
"""The fields that numbers are read from, by event of the mission."""


@dataclass(frozen=True)
class Attempt:
    """One attempt's folder; `repeat` counts how often its number was flown again after a void attempt."""

    path: Path
    protocol: str
    number: int
    repeat: int = 0

    def manifest(self) -> dict[str, Any]:
        """Read the manifest. Raises ResultsError if it is missing or not what a run writes."""
        path = self.path / "manifest.json"
        found = read_json(path)
        if found.get("version") != MANIFEST_VERSION:
            raise ResultsError(f"{path}: version is {found.get('version')}, expected {MANIFEST_VERSION}")
        for name, kind in _MANIFEST_FIELDS.items():
            if name not in found:
                raise ResultsError(f"{path}: {name} is missing")
            if not isinstance(found[name], kind):
                raise ResultsError(f"{path}: {name}: expected {'text' if kind is str else 'an object'}")
        if found["status"] not in ("running", "completed", "failed", "void"):
            raise ResultsError(f"{path}: status is {found['status']}, expected completed, failed or void")
        _topology_of(found["topology"], path)
        return {"reason": None, **found}

    def topology(self) -> Topology:
        return _topology_of(self.manifest()["topology"], self.path / "manifest.json")

    @property
    def is_readable(self) -> bool:
        """Whether its manifest can be read."""
        try:
            self.manifest()
        except ResultsError:
            return False
        return True

    @property
    def key_log(self) -> Path:
        """The log of the session keys that decrypt its captures, if its fleet flew encrypted."""
        return self.path / KEY_LOG

    @property
    def was_flown(self) -> bool:
        """Whether the mission began to record events."""
        return (self.path / "events.jsonl").exists()

    def events(self) -> list[dict[str, Any]]:
        """The mission's events. Raises ResultsError as `read_json_lines`, and for a field of another version."""
        path = self.path / "events.jsonl"
        found = read_json_lines(path)
        for number, event in enumerate(found, 1):
            for name, kind in _EVENT_FIELDS.get(event["event"], {}).items():
                if name not in event or not isinstance(event[name], kind):
                    value = repr(event[name]) if name in event else "missing"
                    raise ResultsError(
                        f"{path}, line {number}: {event['event']}: {name} is {value}, as of another version"
                    )
        return found

    def autopilot_events(self) -> dict[str, list[dict[str, Any]]]:
        """The events in the autopilots' own logs, by node."""
        return {path.stem: read_json_lines(path) for path in sorted((self.path / "sitl").glob("*.jsonl"))}

    def captures(self) -> list[dict[str, Any]]:
        """The counts of each capture; empty if the network did not end properly."""
        path = self.path / "pcap" / "captures.json"
        if not path.exists():
            return []
        found = _read_json(path)
        if not isinstance(found, list) or not all(isinstance(c, dict) and {"node", "dropped"} <= set(c) for c in found):
            raise ResultsError(f"{path}: expected a list of captures, each with node and dropped")
        return found


@dataclass(frozen=True)
class Series:
    """One series: attempts of an experiment in an arm on a profile, begun at one time."""

    path: Path

    def attempts(self) -> list[Attempt]:
        """Every attempt, sorted by protocol, number and repeat."""
        found = [attempt_of(path) for path in self.path.glob("*/attempt-*")]
        return sorted(
            (attempt for attempt in found if attempt is not None),
            key=lambda attempt: (attempt.protocol, attempt.number, attempt.repeat),
        )

    def readable(self) -> list[Attempt]:
        """The attempts whose manifests can be read; all others are void, and `metrics.json` says why."""
        return [attempt for attempt in self.attempts() if attempt.is_readable]


def attempt_of(path: Path) -> Attempt | None:
    """The attempt in a folder `<protocol>/attempt-NN` or `…-repeat-N`; None for any other path."""
    named = _ATTEMPT.fullmatch(path.name)
    if named is None or not path.is_dir():
        return None
    return Attempt(path, path.parent.name, int(named["number"]), int(named["repeat"] or 0))


def series_folder(root: Path, experiment: str, arm: str, profile: str) -> Path:
    """The folder for the series of an experiment in an arm on a profile; `arm` includes the factors that deviate."""
    return root / experiment / f"{arm}-{profile}"


def new_series(root: Path, experiment: str, arm: str, profile: str) -> Series:
    """Make a new folder for a series, never an existing one; `arm` includes the factors that deviate from it."""
    name = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
    folder = series_folder(root, experiment, arm, profile)
    if ":" in str(folder) or not str(folder).isprintable():
        raise UserError(f"results folder {str(folder)!r}: expected no ':' and no control character: Docker mounts it")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for suffix in ("", *(f"-{n}" for n in range(2, 100))):
            path = folder / f"{name}{suffix}"
            if not path.exists():
                path.mkdir()
                return Series(path)
    except OSError as error:
        raise UserError(f"results folder {folder}: {error.strerror}") from error
    raise UserError(f"results folder {folder}: 99 series began in the same second")


def new_attempt(series: Series, protocol: str, number: int, repeat: int = 0) -> Attempt:
    """Make a folder for an attempt, writable from inside the containers."""
    path = series.path / protocol / (f"attempt-{number:02d}" + (f"-repeat-{repeat}" if repeat else ""))
    _make_folders(path, exist_ok=False)
    return Attempt(path, protocol, number, repeat)


def live_attempt(path: Path, protocol: str) -> Attempt:
    """Make a folder for a flight that is no attempt of a series, as of a fleet flown by hand.

    Earlier files of links and session keys are removed from it.
    """
    _make_folders(path)
    attempt = Attempt(path, protocol, 1)
    for left in (*(path / LINKS).iterdir(), *attempt.key_log.parent.iterdir()):
        left.unlink()
    return attempt


def _make_folders(path: Path, *, exist_ok: bool = True) -> None:
    for folder in (path, *(path / name for name in FOLDERS)):
        folder.mkdir(parents=True, exist_ok=exist_ok)
        folder.chmod(0o777)


def point_latest(series: Series) -> None:
    """Make `results/<experiment>/latest` point to a series."""
    point(series.path.parent.parent / "latest", series.path)


def point(link: Path, target: Path) -> None:
    """Make a link point to a folder, atomically."""
    fresh = fresh_beside(link)
    fresh.symlink_to(os.path.relpath(target, link.parent))
    fresh.replace(link)


def open_series(path: Path) -> Series:
    """Open a series by its folder, `latest` included. Raises UserError if the path is no series."""
    if not path.is_dir():
        raise UserError(f"{path}: expected a results folder")
    series = Series(path.resolve())
    if not series.attempts():
        raise UserError(f"{path}: expected a series, with <protocol>/attempt-NN in it")
    return series


def write_json(path: Path, document: Any) -> None:
    """Write a document as `write_text` does."""
    write_text(path, json.dumps(document, indent=1, sort_keys=False) + "\n")


def write_text(path: Path, text: str) -> None:
    """Write a file, or the one that a link points to, completely or not at all. Raises OSError that names it."""
    target = path.resolve()
    fresh = fresh_beside(target)
    try:
        fresh.write_text(text, encoding="utf-8")
        fresh.replace(target)
    except OSError as error:
        fresh.unlink(missing_ok=True)
        raise OSError(error.errno, error.strerror, str(path)) from error


def fresh_beside(path: Path) -> Path:
    """A name for what will replace a file at once; two reports of one series at a time do not share it."""
    return path.with_name(f".{path.name}.{uuid4().hex[:8]}.new")


def read_json(path: Path) -> dict[str, Any]:
    """Read a file's JSON object. Raises ResultsError if it has none."""
    found = _read_json(path)
    if not isinstance(found, dict):
        raise ResultsError(f"{path}: expected an object")
    return found


def read_json_lines(path: Path, needed: frozenset[str] = frozenset({"t_ns", "event"})) -> list[dict[str, Any]]:
    """Read the events of a file, without a last line that was cut off; empty if there is no file.

    Raises ResultsError that names a line which is no event with all the fields `needed`.
    """
    if not path.exists():
        return []
    found = []
    lines = path.read_bytes().split(b"\n")
    for number, line in enumerate(lines[:-1], 1):  # after the last line's end is nothing, or a line that was cut off
        try:
            event = json.loads(line)
        except ValueError as error:
            raise ResultsError(f"{path}, line {number}: not JSON: {error}") from error
        if not isinstance(event, dict) or not needed <= set(event):
            raise ResultsError(f"{path}, line {number}: expected an event with t_ns")
        if "t_ns" in needed and not (type(event["t_ns"]) is int and 0 <= event["t_ns"] < 2**63):
            raise ResultsError(f"{path}, line {number}: t_ns is {event['t_ns']!r}, expected nanoseconds")
        if not isinstance(event.get("event", ""), str):
            raise ResultsError(f"{path}, line {number}: event is {event['event']!r}, expected text")
        found.append(event)
    return found


def _topology_of(described: Mapping[str, Any], path: Path) -> Topology:
    """The topology in a manifest. Raises ResultsError if it is not what a run writes."""
    try:
        nodes = tuple(Node(str(node["name"]), str(IPv4Address(node["address"]))) for node in described["nodes"])
        links = tuple(Link(*(str(link[name]) for name in ("name", "lower", "upper"))) for link in described["links"])
    except (LookupError, TypeError, ValueError) as error:
        raise ResultsError(f"{path}: topology: expected nodes with their addresses, and links ({error!r})") from error
    names = {node.name for node in nodes}
    for link in links:
        if ":" not in link.name or not {link.lower, link.upper} <= names:
            raise ResultsError(
                f"{path}: topology: link {link.name!r}: expected CLASS:NODE, and both of its ends among the nodes"
            )
    return Topology(nodes, links)


def _read_json(path: Path) -> Any:
    try:
        return json.loads(path.read_bytes())
    except OSError as error:
        raise ResultsError(f"{path}: {error.strerror}") from error
    except ValueError as error:
        raise ResultsError(f"{path}: not JSON: {error}") from error
