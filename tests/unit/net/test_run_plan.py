"""A run's plan as the host writes it is what `net` reads."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from net.emulator.plan import PlanError
from net.link_plan import Gate
from net.shaping.run_plan import RunPlan, read_run_plan
from testbed.plan.documents import ROOT
from testbed.plan.fleets import standard_fleet
from testbed.plan.profiles import run_plan as host
from testbed.plan.profiles.reading import read_profile
from testbed.plan.profiles.resolve import resolve

TOPOLOGY = standard_fleet().topology()


def _data(profile: str, **options: Any) -> dict[str, Any]:
    return host.run_plan(resolve(read_profile(profile), TOPOLOGY, "scenario-1", 1, 30), TOPOLOGY, **options)


def _read(folder: Path, data: object) -> RunPlan:
    path = folder / "plan.json"
    path.write_text(json.dumps(data))
    return read_run_plan(path)


def test_what_the_host_writes_is_read(tmp_path: Path) -> None:
    gate = host.Gate("air:uav1", 1, 47.4, 8.5)
    run = _read(tmp_path, _data("leo", shaper="nfqueue", gates=[gate]))
    assert (run.shaper, run.always, run.plan.profile) == ("nfqueue", False, "leo")
    assert run.gates == (Gate("air:uav1", 1, 47.4, 8.5, 50.0),)
    assert run.gates[0].ways == ("air:uav1:up", "air:uav1:down")
    assert set(run.kernel["links"]) == set(run.plan.links), "a link with a gate may need its stages"


def test_a_plan_that_does_nothing_is_told_from_one_that_may(tmp_path: Path) -> None:
    assert not _read(tmp_path, _data("ideal")).is_shaped
    assert _read(tmp_path, _data("ideal", always=True)).is_shaped
    assert _read(tmp_path, _data("ideal", gates=[host.Gate("air:uav1", 1, 47.4, 8.5)])).is_shaped
    assert _read(tmp_path, _data("lan")).is_shaped


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"version": 2}, "version 2: expected 1"),
        ({"shaper": "tc"}, "shaper 'tc': expected one of auto, "),
        ({"always": "yes"}, "always 'yes': expected true or false"),
        ({"gate": []}, "unknown field 'gate'; expected version, shaper, "),
        ({"gates": {}}, "gates {}: expected a list"),
        (
            {"gates": [{"link": "air:uav1:up"}]},
            "gates[0].link 'air:uav1:up': expected a link of the plan, without its d",
        ),
        ({"gates": [{"link": "air:uav1", "drone": True}]}, "gates[0].drone True: expected a drone's number"),
        (
            {"gates": [{"link": "air:uav1", "drone": 1, "latitude_deg": 91}]},
            "gates[0].latitude_deg 91: expected a number from -90 to 90",
        ),
        ({"plan": {"version": 1}}, "plan: profile None: expected a name"),
    ],
)
def test_what_makes_no_sense_is_named(tmp_path: Path, change: dict[str, Any], said: str) -> None:
    with pytest.raises(PlanError) as error:
        _read(tmp_path, {**_data("ideal"), **change})
    assert said in str(error.value)
    assert str(error.value).startswith(str(tmp_path / "plan.json"))


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(PlanError) as error:
        read_run_plan(tmp_path / "plan.json")
    assert str(error.value) == f"{tmp_path}/plan.json: No such file or directory; expected a plan in JSON"


def test_the_plan_that_the_image_has_shapes_nothing() -> None:
    assert not read_run_plan(ROOT / "services" / "net" / "unshaped.json").is_shaped
