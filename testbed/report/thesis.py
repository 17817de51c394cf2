"""The thesis's printed figures and what to know about them, from `thesis.yaml` beside this module."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import yaml

FIGURES = Path(__file__).parent / "thesis.yaml"
_UNITS = {"size_mb": ("size_bytes", 1e6), "packets": ("packets", 1), "mission_s": ("mission_s", 1)}
_UNITS |= {"loss_pct": ("wire_loss", 0.01)}


@cache
def everything() -> dict[str, Any]:
    """The whole file."""
    found: dict[str, Any] = yaml.safe_load(FIGURES.read_text(encoding="utf-8"))
    return found


def of_scenario(experiment: str) -> dict[str, dict[str, float]]:
    """Its means by our metric and protocol, in our units (bytes, seconds, shares): {"packets": {"mavlink": 512827, …}}.

    Empty for an experiment that it did not fly.
    """
    printed = everything()["scenarios"].get(experiment, {})
    found = {}
    for name, by_protocol in printed.items():
        field, unit = _UNITS[name]
        found[field] = {protocol: round(value * unit, 4) for protocol, value in by_protocol.items()}
    return found


def packet_sizes() -> dict[str, dict[str, int]]:
    """Bytes of a packet between two nodes, by kind of message and protocol."""
    found: dict[str, dict[str, int]] = everything()["packet_size_bytes"]
    return found


def scenarios() -> tuple[str, ...]:
    """The experiments that it flew, in its order."""
    return tuple(everything()["scenarios"])


def caveats(experiment: str) -> tuple[str, ...]:
    """What to know before setting its figures of this experiment beside others; empty where it has none."""
    if experiment not in everything()["scenarios"]:
        return ()
    return tuple(entry["text"] for entry in everything()["caveats"] if {"scenarios", experiment} & set(entry["about"]))
