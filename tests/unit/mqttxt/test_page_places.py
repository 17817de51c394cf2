"""Places with names, of a GeoJSON file, and what is wrong with a file (docs/page.md)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from pmtiles.tile import TileType

from mqttxt import ConfigurationError
from mqttxt.cli.page import whole_paths
from mqttxt.demo.fleet import DRONES, PLACES, places_file
from mqttxt.page.places import MOST_BYTES, MOST_PLACES, Place, load
from tests.simulation.map_tiles import pmtiles, png
from tests.unit.mqttxt.typed import refused

POINT = {"type": "Point", "coordinates": [8.5470, 47.3985]}


def feature(name: object = "Church", **geometry: Any) -> dict[str, Any]:
    return {"type": "Feature", "properties": {"name": name}, "geometry": POINT | geometry}


def collection(*features: Any) -> str:
    return json.dumps({"type": "FeatureCollection", "features": list(features)})


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "places.geojson"


def test_points_with_names_are_places(path: Path) -> None:
    path.write_text(
        collection(feature(" Saint\nAlban "), feature("Hill", coordinates=[-8, 47.12345678, 600])), "utf-8-sig"
    )
    assert load(str(path)) == (Place("Saint\\nAlban", 47.3985, 8.547), Place("Hill", 47.1234568, -8.0))


def test_without_a_file_there_are_none() -> None:
    assert load(None) == ()


def test_the_demos_places_are_near_its_drones_and_a_church_is_among_them(path: Path) -> None:
    path.write_text(places_file())
    places = load(str(path))
    assert {place.name: (place.latitude_deg, place.longitude_deg) for place in places} == PLACES
    assert "Church" in PLACES
    for drone in DRONES.values():
        for place in places:
            north_m = (place.latitude_deg - drone.latitude_deg) * 111_000
            assert abs(north_m) < 300
            assert abs(place.longitude_deg - drone.longitude_deg) * 75_000 < 300


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("", "expected a GeoJSON file of points, each with a name"),
        ("[" * 100_000, "expected a GeoJSON file of points, each with a name"),
        ("\xff", "expected a GeoJSON file of points, each with a name"),
        ("[]", "type []: expected 'FeatureCollection'"),
        ('{"type": "Feature"}', "type 'Feature': expected 'FeatureCollection'"),
        ('{"type": "FeatureCollection"}', "features: None; expected a list of 1 to 1000"),
        (collection(), "features: 0 of them; expected a list of 1 to 1000"),
        (collection(*([1] * (MOST_PLACES + 1))), "features: 1001 of them; expected a list of 1 to 1000"),
        (collection(feature(), 5), "feature 2: type 5: expected 'Feature'"),
        (collection({"type": "Feature"}), "feature 1: properties.name None: expected 1 to 60 characters"),
        (collection(feature(" ")), "feature 1: properties.name ' ': expected 1 to 60 characters"),
        (collection(feature(7)), "feature 1: properties.name 7: expected 1 to 60 characters"),
        (collection(feature("x" * 61)), "expected 1 to 60 characters"),
        (collection(feature(), feature()), "feature 2: properties.name 'Church': expected each name once"),
        (
            collection(feature(type="LineString")),
            "feature 1: geometry.type 'LineString': expected 'Point'",
        ),
        (
            collection(feature(coordinates=[8])),
            "feature 1: geometry.coordinates [8]: expected [longitude, latitude]",
        ),
        (
            collection(feature(coordinates=[True, float("nan")])),
            "feature 1: geometry.coordinates [True, nan]: expected [longitude, latitude]",
        ),
        (
            collection(feature(coordinates=[10**400, 1])),
            "expected [longitude, latitude]",
        ),
        (
            collection(feature(coordinates=[47.4, 98.5])),
            "feature 1: geometry.coordinates: latitude 98.5: expected a number from -90 to 90; "
            "the longitude is the first of the two",
        ),
        (
            collection(feature(coordinates=[181, 1])),
            "feature 1: geometry.coordinates: longitude 181: expected a number from -180 to 180; "
            "the longitude is the first of the two",
        ),
    ],
)
def test_another_file_is_one_line(path: Path, content: str, says: str) -> None:
    path.write_text(content, "latin-1")
    with pytest.raises(ConfigurationError) as error:
        load(str(path))
    assert str(error.value).startswith(f"--places {path}: ")
    assert str(error.value).endswith(says)
    assert "\n" not in str(error.value)


def test_a_file_that_is_too_large_is_one_line(path: Path) -> None:
    path.write_bytes(bytes(MOST_BYTES + 1))
    with pytest.raises(ConfigurationError, match=f"--places {path}: 1048577 bytes; expected at most 1048576$"):
        load(str(path))


async def test_the_demos_page_which_runs_in_another_folder_has_whole_paths(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path.write_text(places_file())
    tiles = pmtiles(path.with_name("a.pmtiles"), png((1, 2, 3)), TileType.PNG, 47, 8)
    monkeypatch.chdir(path.parent)
    assert await whole_paths(tiles.name, path.name) == (str(tiles), str(path))
    address = "https://tiles.example/{z}/{x}/{y}.png"
    assert await whole_paths(address, None) == (address, None)


@pytest.mark.parametrize("typed", [["gs", "page", "--fog", "1"], ["demo"]])
@pytest.mark.parametrize("option", ["--places", "--tiles"])
def test_a_file_that_is_not_there_is_a_users_mistake_before_anything_starts(option: str, typed: list[str]) -> None:
    said = refused(*typed, option, "/nowhere/a.geojson")
    assert said.startswith(f"{option} /nowhere/a.geojson: No such file or directory; expected ")
