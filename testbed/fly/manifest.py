"""The manifest: the conditions under which an attempt was flown, written at run time."""

from __future__ import annotations

import os
import platform
import re
import subprocess
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

from ..plan.documents import ROOT
from ..plan.experiments import Plan
from ..plan.fleets import standard_fleet
from ..plan.profiles.resolve import LinksPlan
from .results import MANIFEST_VERSION, Attempt

NODE_PACKAGES = {
    "mqttxt": ("paho-mqtt", "pymavlink", "cbor2", "fastcrc"),
    "mavlink": ("mavsdk", "pymavlink", "fastcrc"),
}
ROUTER_MODULE = ROOT / "services" / "router" / "go.mod"
SITL_SEED = 1


def describe(plan: Plan, attempt: Attempt, settings: dict[str, str], links: LinksPlan) -> dict[str, Any]:
    """The entries of the manifest that are known before the containers start."""
    return {
        "version": MANIFEST_VERSION,
        "experiment": plan.experiment,
        "arm": plan.arm.name,
        "profile": plan.profile.name,
        "protocol": attempt.protocol,
        "attempt": attempt.number,
        "repeat": attempt.repeat,
        "order": list(plan.order(attempt.number)),
        "status": "running",
        "reason": None,
        "revision": revision(),
        "configuration": configuration_of(plan, settings),
        "seeds": {
            "sitl": SITL_SEED,
            "links": links.seed,
            **({"order": plan.order_seed} if plan.order_seed is not None else {}),
        },
        "shaper": "none",  # until `net` reports the shaper
        "host": {
            "name": machine_name(),
            "kernel": platform.release(),
            "machine": platform.machine(),
            "cores": os.cpu_count(),
            "python": platform.python_version(),
            "load_before": os.getloadavg()[0],
        },
        "versions": _versions(plan, attempt.protocol),
        "topology": {
            "nodes": [asdict(node) for node in plan.topology.nodes],
            "links": [asdict(link) for link in plan.topology.links],
        },
    }


def machine_name() -> str:
    """This machine's name in results: MACHINE, or its host name."""
    return os.environ.get("MACHINE") or platform.node()


def configuration_of(plan: Plan, settings: dict[str, str]) -> dict[str, Any]:
    """The factors, compose.yaml's variables, messages of each kind, another fleet's size, and other machines."""
    size = {"fogs": len(plan.fleet.fogs), "drones": len(plan.fleet.fog_of)}
    return {
        **asdict(plan.factors),
        **settings,
        **({"count": plan.count} if plan.is_message_set else {}),
        **(size if plan.fleet != standard_fleet() else {}),
        **({"machines": [machine.name for machine in plan.machines]} if plan.machines else {}),
    }


def revision() -> dict[str, Any]:
    """The git revision, and whether the tree has uncommitted changes; both None outside a repository."""
    try:
        found = subprocess.run(["git", "rev-parse", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=True)
        changed = subprocess.run(["git", "status", "--porcelain"], cwd=ROOT, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return {"commit": None, "dirty": None}
    return {"commit": found.stdout.strip(), "dirty": bool(changed.stdout.strip())}


def mavp2p_version(module: Path = ROUTER_MODULE) -> str | None:
    """The version that the router's go.mod requires, since a built mavp2p does not report its own."""
    try:
        text = module.read_text(encoding="utf-8")
    except OSError:
        return None
    found = re.search(r"^(?:require)?\s*github\.com/bluenviron/mavp2p v(\S+)", text, re.MULTILINE)
    return found[1] if found else None


def mosquitto_version(help_text: str) -> str | None:
    """The version in `mosquitto -h`'s first line."""
    found = re.search(r"mosquitto version (\S+)", help_text)
    return found[1] if found else None


def _versions(plan: Plan, protocol: str) -> dict[str, str | None]:
    """The pinned versions of the programs that carry a protocol; a running broker is asked for its own later."""
    found = {name: _pinned(name) for name in NODE_PACKAGES[protocol]} | {"scapy": version("scapy")}
    routed = protocol == "mavlink" and plan.factors.chain != "direct"
    return found | {"mavp2p": mavp2p_version()} if routed else found


def _pinned(package: str) -> str | None:
    """The version in the containers' lock file."""
    lock = Path(ROOT / "requirements" / "node.txt").read_text(encoding="utf-8")
    found = re.search(rf"^{re.escape(package)}==(\S+)", lock, re.MULTILINE)
    return found[1] if found else None
