"""Compose files that a user lays over compose.yaml: another autopilot (AUTOPILOT), another build of mavp2p (ROUTER)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from ..errors import UserError
from .autopilots import KINDS
from .topology import COMPOSE_FILE, ROOT

OVERRIDES = {
    "AUTOPILOT": {name: ROOT / "services" / "sitl" / "overrides" / f"{name}.yaml" for name in KINDS},
    "ROUTER": {"official": ROOT / "services" / "router" / "overrides" / "official.yaml"},
}
"""Variables, their names and what each name stands for; a compose file of one's own is named by its path."""


def chosen(environment: Mapping[str, str]) -> dict[str, str]:
    """What the environment asks for, checked; of an autopilot also where it is.

    Raises UserError for a name, file or folder that is not there.
    """
    found = {name: environment[name] for name in OVERRIDES if environment.get(name)}
    for name, value in found.items():
        _file(name, value)
    kind = KINDS.get(found.get("AUTOPILOT", ""))
    return found if kind is None else found | kind.settings(environment)


def suffix(settings: Mapping[str, str]) -> str:
    """What the results' path says of them, as `+autopilot-px4`; a file of one's own by its name."""
    found = [f"+{name.lower()}-{Path(settings[name]).stem}" for name in OVERRIDES if settings.get(name)]
    return "".join(found)


def compose_files(settings: Mapping[str, str]) -> list[Path]:
    """compose.yaml and what is laid over it, in the order in which compose takes them."""
    return [COMPOSE_FILE, *(_file(name, settings[name]) for name in OVERRIDES if settings.get(name))]


def _file(name: str, value: str) -> Path:
    known = OVERRIDES[name]
    path = known.get(value) or Path(value).expanduser().absolute()
    if not path.is_file():
        raise UserError(f"{name}={value}: expected {', '.join(known)}, or a compose file of your own")
    return path
