"""Versions that no running program can tell are read from where they are pinned."""

from __future__ import annotations

from pathlib import Path

import pytest

from testbed.fly.links import plan_links
from testbed.fly.manifest import configuration_of, describe, mavp2p_version, mosquitto_version
from testbed.fly.results import Attempt
from testbed.plan.experiments import make_plan
from testbed.plan.fleets import fleet_of


@pytest.mark.parametrize(
    "required",
    [
        "require github.com/bluenviron/mavp2p v1.3.3\n",
        "require (\n\tgithub.com/bluenviron/gomavlib/v3 v3.1.0 // indirect\n\tgithub.com/bluenviron/mavp2p v1.3.3\n)\n",
    ],
)
def test_the_routers_version_is_the_one_that_go_mod_requires(tmp_path: Path, required: str) -> None:
    module = tmp_path / "go.mod"
    module.write_text(f"module router\n\ngo 1.25\n\ntool github.com/bluenviron/mavp2p\n\n{required}")
    assert mavp2p_version(module) == "1.3.3"


def test_a_version_that_nothing_tells_is_none(tmp_path: Path) -> None:
    assert mavp2p_version(tmp_path / "go.mod") is None
    (tmp_path / "go.mod").write_text("module router\n")
    assert mavp2p_version(tmp_path / "go.mod") is None
    assert mosquitto_version("exec: mosquitto: not found") is None


def test_the_size_and_the_topology_of_another_fleet_are_in_the_manifest() -> None:
    plan = make_plan("scenario-4", fleet=fleet_of({"FOGS": "3", "DRONES": "9"}))
    found = describe(plan, Attempt(Path("attempt-01"), "mqttxt", 1), {"QOS": "0"}, plan_links(plan, 1))
    assert (found["configuration"]["fogs"], found["configuration"]["drones"]) == (3, 9)
    assert len(found["topology"]["nodes"]) == 2 + 3 + 9 + 9
    assert {"name": "air:uav9", "lower": "uav9", "upper": "fog3"} in found["topology"]["links"]
    assert not {"fogs", "drones"} & set(configuration_of(make_plan("scenario-4"), {}))


def test_a_fleet_without_routers_names_no_router() -> None:
    plan = make_plan("scenario-1", arm="direct")
    attempt = Attempt(Path("attempt-01"), "mavlink", 1)
    assert "mavp2p" not in describe(plan, attempt, {}, plan_links(plan, 1))["versions"]
