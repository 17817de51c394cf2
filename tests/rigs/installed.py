"""A newcomer's installation: wheels built from the tree, in a virtual environment of their own, without a network."""

from __future__ import annotations

import importlib.metadata
import shutil
import subprocess
import sys
from collections.abc import Collection
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.rigs.processes import ROOT

_PARTS = ("mqttxt", "sitl")
_OWN = {"mqttxt", "mqttxt-sitl"}
_PIP = (sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet")


def installed_demo(folder: Path) -> Path:
    """A virtual environment in `folder` with `mqttxt[demo]` and what that declares; returns its `mqttxt`."""
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder], check=True)
    python = folder / "bin" / "python"
    (site,) = folder.glob("lib/python3*/site-packages")
    wheels = folder / "wheels"
    for part in _PARTS:
        source = folder / "source" / part
        shutil.copytree(ROOT / "services" / part, source, ignore=shutil.ignore_patterns("build", "*.egg-info"))
        offline = ("--no-index", "--no-deps", "--no-build-isolation")
        subprocess.run([*_PIP, "wheel", *offline, "--wheel-dir", wheels, source], check=True)
    built = [*importlib.metadata.distributions(path=[str(wheel) for wheel in wheels.iterdir()])]
    assert {found.name for found in built} == _OWN
    for name in declared([line for found in built for line in found.requires or ()], "demo") - _OWN:
        copy_distribution(name, site)
    offline = ("--no-index", "--find-links", str(wheels))
    subprocess.run([*_PIP, "--python", python, "install", *offline, "mqttxt[demo]"], check=True)
    return folder / "bin" / "mqttxt"


def declared(lines: Collection[str], extra: str) -> set[str]:
    """The distributions that our own requirements name for an extra, directly and indirectly."""
    found: dict[str, set[str]] = {}
    waiting = [(Requirement(line), extra) for line in lines]
    while waiting:
        requirement, of_extra = waiting.pop()
        if requirement.marker is not None and not requirement.marker.evaluate({"extra": of_extra}):
            continue
        name = canonicalize_name(requirement.name)
        extras = {"", *requirement.extras} - found.setdefault(name, set())
        found[name] |= extras
        for line in lines if name in _OWN else importlib.metadata.requires(name) or ():
            waiting += [(Requirement(line), each) for each in extras]
    return set(found)


def copy_distribution(name: str, site: Path) -> None:
    """Copy an installed distribution's files, programs aside."""
    distribution = importlib.metadata.distribution(name)
    for file in distribution.files or ():
        if ".." not in file.parts:
            target = site / file
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(str(distribution.locate_file(file)), target)
