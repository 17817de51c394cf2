"""`mqttxt gs params` as people type it, over real brokers and processes, with the stand-in as autopilot."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from mqttxt import Parameters
from tests.rigs import prefork
from tests.rigs.processes import System

pytestmark = [pytest.mark.integration]

Typed = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def params(shared_system: System, tmp_path: Path) -> Typed:
    cloud = ("--cloud", shared_system.cloud.url)
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path / "cache")}

    def typed(*words: str) -> subprocess.CompletedProcess[str]:
        return prefork.run("mqttxt", "gs", "params", *words, "--drone", "1", *cloud, environment=environment)

    return typed


def test_parameters_are_listed_set_saved_compared_and_loaded(params: Typed, tmp_path: Path) -> None:
    listed = params("list", "MPC_XY_*")
    assert (listed.returncode, listed.stdout.split()) == (
        0,
        ["MPC_XY_CRUISE", "12", "real32", "MPC_XY_VEL_MAX", "12", "real32"],
    ), listed.stderr
    file = tmp_path / "drone1.params"
    saved = params("save", str(file))
    assert saved.stdout == f"{file}: {len(Parameters.load(file))} parameters\n"
    done = params("set", "MPC_XY_CRUISE", "6.5")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "set_parameter completed" in done.stdout
    assert params("get", "MPC_XY_CRUISE", "RTL_CONE_ANG").stdout == "6.5\n45\n"
    differing = params("diff", str(file))
    assert (differing.returncode, differing.stdout) == (1, "MPC_XY_CRUISE: 12 and 6.5\n")
    loaded = params("load", str(file))
    assert loaded.returncode == 0, loaded.stdout + loaded.stderr
    assert loaded.stdout.splitlines()[-1] == "1 of 1 parameters were set"
    assert (params("diff", str(file)).returncode, params("diff", str(file)).stdout) == (0, "")
