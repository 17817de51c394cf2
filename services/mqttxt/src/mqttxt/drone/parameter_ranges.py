"""The documented ranges of parameters, from the files that PX4's and ArduPilot's builds make."""

from __future__ import annotations

import json
import lzma
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from ..errors import ConfigurationError
from ..security import files

Range = tuple[float, float]
_EXPECTED = "expected PX4's parameters.json (also as .xz) or ArduPilot's apm.pdef.json"


def load(path: Path) -> dict[str, Range]:
    """The least and the greatest value of each parameter that has both. Raises ConfigurationError."""
    data = files.read(path)
    try:
        document = json.loads(lzma.decompress(data) if path.suffix == ".xz" else data)
        found = dict(_of_px4(document) if "parameters" in document else _of_ardupilot(document))
    except (ValueError, TypeError, KeyError, AttributeError, lzma.LZMAError, RecursionError) as error:
        raise ConfigurationError(f"--parameter-ranges {path}: {error}; {_EXPECTED}") from error
    if not found:
        raise ConfigurationError(f"--parameter-ranges {path}: no ranges; {_EXPECTED}")
    return found


def _of_px4(document: Mapping[str, Any]) -> Iterator[tuple[str, Range]]:
    for entry in document["parameters"]:
        if "min" in entry and "max" in entry:
            yield str(entry["name"]), (float(entry["min"]), float(entry["max"]))


def _of_ardupilot(document: Mapping[str, Any]) -> Iterator[tuple[str, Range]]:
    for group, entries in document.items():
        for name, entry in entries.items() if group != "json" else ():
            span = entry.get("Range")
            if span is not None:
                yield str(name), (float(span["low"]), float(span["high"]))
