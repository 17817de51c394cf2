"""The workflow of .github: what it installs and runs is there, on the systems and Pythons that are promised."""

from __future__ import annotations

import ast
import re
import shlex
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path
from typing import Any

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from typer.testing import CliRunner

from mqttxt.cli.main import app

ROOT = Path(__file__).resolve().parents[2]
JOB = yaml.safe_load((ROOT / ".github" / "workflows" / "station.yaml").read_text(encoding="utf-8"))["jobs"]["station"]
PROJECT = tomllib.loads((ROOT / "services" / "mqttxt" / "pyproject.toml").read_text(encoding="utf-8"))["project"]
LINUX_ALONE = {"fcntl", "grp", "pwd", "resource", "sitl", "testbed", "mission", "net", "router", "sensor", "scapy"}


def run(name: str) -> list[str]:
    """The words of a step's command."""
    (step,) = [step for step in JOB["steps"] if step.get("name") == name]
    return shlex.split(step["run"])


def run_files() -> list[Path]:
    return [ROOT / word for word in run("Unit tests") if word.endswith(".py")]


def imported(path: Path) -> set[str]:
    """The first names of what a test file imports, and what it takes from `tests`, in turn."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
        names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        for name in names:
            module = ROOT / f"{name.replace('.', '/')}.py"
            found |= imported(module) if name.startswith("tests.") and module.exists() else {name.split(".")[0]}
    return found


def test_it_runs_where_the_page_says_that_a_station_runs() -> None:
    page = (ROOT / "docs" / "ground-station.md").read_text(encoding="utf-8")
    promised = re.search(r"Python (3\.\d+) to 3\.(\d+) on Linux, macOS and Windows", page)
    assert promised is not None
    assert PROJECT["requires-python"] == f">={promised[1]}"
    oldest, newest = int(promised[1].removeprefix("3.")), int(promised[2])
    matrix: dict[str, Any] = JOB["strategy"]["matrix"]
    assert matrix["python"] == [f"3.{minor}" for minor in range(oldest, newest + 1)]
    assert [system.split("-")[0] for system in matrix["system"]] == ["ubuntu", "macos", "windows"]


def test_every_test_that_it_runs_is_there_and_needs_no_linux() -> None:
    assert len(run_files()) == len(set(run_files())) > 15
    for path in run_files():
        assert path.is_file(), path
        assert not imported(path) & LINUX_ALONE, path


@pytest.mark.long
def test_what_the_tests_import_is_installed_by_it() -> None:
    own, *others = [word for word in run("Install") if word not in ("python", "-m", "pip", "install")]
    folder, _, extras = own.rstrip("]").partition("[")
    assert (ROOT / folder / "pyproject.toml").is_file()
    lines = [*PROJECT["dependencies"], *others]
    for extra in extras.split(","):
        lines += PROJECT["optional-dependencies"][extra]
    installed = {canonicalize_name(Requirement(line).name) for line in lines} | {"mqttxt"}
    known = packages_distributions()
    for name in set().union(*map(imported, run_files())) - sys.stdlib_module_names - {"mqttxt"}:
        assert {canonicalize_name(found) for found in known[name]} & installed, name


def test_the_commands_that_it_types_are_there() -> None:
    commands = [words.split() for words in " ".join(run("The commands")).split(" && ")]
    assert len(commands) == 3
    for program, *arguments in commands:
        assert program == "mqttxt"
        assert CliRunner().invoke(app, arguments).exit_code == 0
