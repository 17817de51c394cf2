"""Compose files on top of compose.yaml: another autopilot (AUTOPILOT), another build of mavp2p (ROUTER)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import yaml

from ..errors import UserError
from . import fleets
from .autopilots import KINDS
from .compose import COMPOSE_FILE, compose_text, laid_over
from .documents import ROOT
from .fleet import Fleet
from .fleets import read_fleet, standard_fleet

FLEET_COPY = "fleet.yaml"
"""The file of another fleet than the experiments', next to a run's own compose files."""
OVERRIDES = {
    "AUTOPILOT": {name: ROOT / "services" / "sitl" / "overrides" / f"{name}.yaml" for name in KINDS},
    "ROUTER": {"official": ROOT / "services" / "router" / "overrides" / "official.yaml"},
}
"""The files by variable and known value; a user's own compose file is given by its path."""


def chosen(environment: Mapping[str, str]) -> dict[str, str]:
    """The checked values of these variables in the environment, and for an autopilot its folder or image.

    Raises UserError for an unknown name, or a file or folder that does not exist.
    """
    found = {name: environment[name] for name in OVERRIDES if environment.get(name)}
    for name, value in found.items():
        _file(name, value)
    kind = KINDS.get(found.get("AUTOPILOT", ""))
    return found if kind is None else found | kind.settings(environment)


def suffix(settings: Mapping[str, str]) -> str:
    """The part of the results' path for fleet and overrides, as `+autopilot-px4`; a user's own file by its name."""
    found = [
        fleets.suffix(settings),
        *(f"+{name.lower()}-{Path(settings[name]).stem}" for name in OVERRIDES if settings.get(name)),
    ]
    return "".join(found)


def compose_files(settings: Mapping[str, str], fleet: Fleet, folder: Path) -> list[Path]:
    """compose.yaml and the files on top of it, in the order for compose.

    For another fleet than the experiments' they are made in `folder`, with a copy of the fleet's file (FLEET_COPY).
    """
    laid = [_file(name, settings[name]) for name in OVERRIDES if settings.get(name)]
    if fleet == standard_fleet():
        (folder / FLEET_COPY).unlink(missing_ok=True)
        return [COMPOSE_FILE, *laid]
    files = {folder / COMPOSE_FILE.name: compose_text(fleet)}
    files |= {folder / path.name: laid_over(path.read_text(encoding="utf-8"), fleet) for path in laid if _is_own(path)}
    for path, text in {**files, folder / FLEET_COPY: yaml.safe_dump(fleet.to_data(), sort_keys=False)}.items():
        path.write_text(text, encoding="utf-8")
        path.chmod(0o644)  # another user reads it in the containers
    return [folder / COMPOSE_FILE.name, *(folder / path.name if _is_own(path) else path for path in laid)]


def fleet_in(folder: Path) -> Fleet:
    """The fleet that `compose_files` made its files for in a folder. Raises UserError as `read_fleet`."""
    copy = folder / FLEET_COPY
    return read_fleet(copy) if copy.exists() else standard_fleet()


def files_of_standard_fleet() -> dict[Path, str]:
    """The contents of the repository's files that are made from services/fleet.yaml."""
    known = [path for by_name in OVERRIDES.values() for path in by_name.values()]
    laid = {path: laid_over(path.read_text(encoding="utf-8"), standard_fleet()) for path in known}
    return {COMPOSE_FILE: compose_text(standard_fleet()), **laid}


def _is_own(path: Path) -> bool:
    """Whether a file is the project's. A user's file is used as it is, since it names the services that it changes."""
    return any(path in known.values() for known in OVERRIDES.values())


def _file(name: str, value: str) -> Path:
    known = OVERRIDES[name]
    path = known.get(value) or Path(value).expanduser().absolute()
    if not path.is_file():
        raise UserError(f"{name}={value}: expected {', '.join(known)}, or a compose file of your own")
    return path
