"""Named places of a GeoJSON file, which are shown on the map and found by name, without any network."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..core.printable import printable
from ..errors import ConfigurationError
from ..protocol.values import shown

MOST_BYTES = 2**20
MOST_PLACES = 1000
MOST_NAME = 60
_DIGITS = 7
"""Decimals of the degrees that the page fills in: about a centimetre."""
_ANY = 1e9
"""The bound of numbers that are accepted: Python also reads NaN, Infinity and endless digits from JSON."""
_EXPECTED = "expected a GeoJSON file of points, each with a name"


@dataclass(frozen=True)
class Place:
    """A point on the ground, in degrees north and east; its `name` is unique in its file."""

    name: str
    latitude_deg: float
    longitude_deg: float


def load(source: str | None) -> tuple[Place, ...]:
    """The places of the file that `--places` names; empty without one. Raises ConfigurationError."""
    if source is None:
        return ()
    try:
        content = Path(source).read_bytes()
    except OSError as error:
        raise ConfigurationError(f"--places {source}: {error.strerror}; {_EXPECTED}") from error
    if len(content) > MOST_BYTES:
        raise ConfigurationError(f"--places {source}: {len(content)} bytes; expected at most {MOST_BYTES}")
    try:
        document = json.loads(content)
    except (ValueError, RecursionError):
        raise ConfigurationError(f"--places {source}: {_EXPECTED}") from None
    try:
        return _places(document)
    except ConfigurationError as error:
        raise ConfigurationError(f"--places {source}: {error}") from None


def _places(document: Any) -> tuple[Place, ...]:
    _is_of(document, "type", "FeatureCollection", "")
    features = document.get("features")
    if not isinstance(features, list) or not 0 < len(features) <= MOST_PLACES:
        got = f"{len(features)} of them" if isinstance(features, list) else shown(features)
        raise ConfigurationError(f"features: {got}; expected a list of 1 to {MOST_PLACES}")
    places: dict[str, Place] = {}
    for number, feature in enumerate(features, 1):
        place = _place(feature, f"feature {number}: ")
        if place.name in places:
            raise ConfigurationError(f"feature {number}: properties.name {place.name!r}: expected each name once")
        places[place.name] = place
    return tuple(places.values())


def _place(feature: Any, where: str) -> Place:
    _is_of(feature, "type", "Feature", where)
    properties, geometry = feature.get("properties"), feature.get("geometry")
    name = properties.get("name") if isinstance(properties, dict) else None
    text = printable(name.strip()) if isinstance(name, str) else ""
    if not 0 < len(text) <= MOST_NAME:
        raise ConfigurationError(f"{where}properties.name {shown(name)}: expected 1 to {MOST_NAME} characters")
    _is_of(geometry, "type", "Point", f"{where}geometry.")
    point = geometry.get("coordinates")
    if not isinstance(point, list) or not 2 <= len(point) <= 3 or not all(map(_is_number, point)):
        raise ConfigurationError(f"{where}geometry.coordinates {shown(point)}: expected [longitude, latitude]")
    longitude_deg, latitude_deg = (round(float(degrees), _DIGITS) for degrees in point[:2])
    for what, degrees, most in (("longitude", longitude_deg, 180), ("latitude", latitude_deg, 90)):
        if abs(degrees) > most:
            raise ConfigurationError(
                f"{where}geometry.coordinates: {what} {degrees:g}: expected a number from -{most} to {most}; "
                "the longitude is the first of the two"
            )
    return Place(text, latitude_deg, longitude_deg)


def _is_of(found: Any, field: str, expected: str, where: str) -> None:
    got = found.get(field) if isinstance(found, dict) else found
    if not isinstance(found, dict) or got != expected:
        raise ConfigurationError(f"{where}{field} {shown(got)}: expected {expected!r}")


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < _ANY
