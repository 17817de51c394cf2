"""The compose files of a fleet: every node with its network and its services."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from ..errors import UserError
from .documents import ROOT
from .fleet import AUTOPILOT_PORT, FIRST_PORT, Fleet

TEMPLATE = Path(__file__).with_name("compose.yaml.jinja")
COMPOSE_FILE = ROOT / "compose.yaml"
PROJECT = "mqttxt-testbed"
"""Compose's project name."""
_SERVICES = "\nservices:\n"


def compose_text(fleet: Fleet) -> str:
    """The compose file of a fleet."""
    environment = Environment(
        loader=FileSystemLoader(TEMPLATE.parent),
        undefined=StrictUndefined,
        autoescape=False,  # not HTML, but YAML for compose
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    (one,) = next(iter(fleet.one.values()))
    return environment.get_template(TEMPLATE.name).render(
        fleet=fleet,
        one=one,
        nodes=fleet.nodes(),
        nodes_and_sensors=fleet.nodes(sensors=True),
        port=FIRST_PORT,
        autopilot_port=AUTOPILOT_PORT,
    )


def laid_over(text: str, fleet: Fleet) -> str:
    """Rewrite for this fleet a compose file that changes the autopilots or the routers of another one.

    The entry of its first service is used for each service of that kind.
    """
    head, _, services = text.partition(_SERVICES)
    first, _, change = services.splitlines()[0].strip().partition(": ")
    names = [f"sitl{drone}" for drone in fleet.fog_of]
    if first.startswith("router-"):
        names = [f"router-{node}" for node in fleet.nodes()]
    return f"{head}{_SERVICES}" + "".join(f"  {name}: {change}\n" for name in names)


def read_services(path: Path = COMPOSE_FILE) -> dict[str, Any]:
    """The services of a compose file by name. Raises UserError if it has none."""
    try:
        services: dict[str, Any] = yaml.load(path.read_text(encoding="utf-8"), yaml.CSafeLoader)["services"]
    except (OSError, yaml.YAMLError, KeyError, TypeError) as error:
        raise UserError(f"{path}: expected a compose file with services: {' '.join(str(error).split())}") from error
    return services
