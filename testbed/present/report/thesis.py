"""The thesis's printed figures and their caveats, from `thesis.yaml` next to this module."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import yaml

from ...numbers.written import Metrics
from .comparison import completed, fleet_size

FIGURES = Path(__file__).parent / "thesis.yaml"
_UNITS = {"size_mb": ("size_bytes", 1e6), "packets": ("packets", 1), "mission_s": ("mission_s", 1)}
_UNITS |= {"loss_pct": ("wire_loss", 0.01)}
MESSAGE_SET = "messages"
FLEET = (2, 6)
"""The numbers of fogs and drones in its scenarios."""
MESSAGES = 100
"""The number of messages of each kind in its table 5.3."""
_COMPUTED = (66.0, 68.0)
"""Bytes per packet that its MQTT-XT sizes have to the digit: those sizes are packets times this."""


@cache
def everything() -> dict[str, Any]:
    """The whole file."""
    found: dict[str, Any] = yaml.safe_load(FIGURES.read_text(encoding="utf-8"))
    return found


def of_scenario(experiment: str) -> dict[str, dict[str, float]]:
    """The thesis's means by our metric and protocol, in our units (bytes, seconds, shares), as
    {"packets": {"mavlink": 512827, …}}. Empty for an experiment that the thesis does not have.
    """
    printed = everything()["scenarios"].get(experiment, {})
    found = {}
    for name, by_protocol in printed.items():
        field, unit = _UNITS[name]
        found[field] = {protocol: round(value * unit, 4) for protocol, value in by_protocol.items()}
    return found


def flew_alike(metrics: Metrics) -> bool:
    """Whether every completed attempt had the thesis's numbers of fogs and drones, so that its figures compare."""
    return {fleet_size(one) for side in metrics["protocols"].values() for one in completed(side)} <= {FLEET}


def packet_sizes() -> dict[str, dict[str, int]]:
    """Bytes per packet between two nodes, by kind of message and protocol."""
    found: dict[str, dict[str, int]] = everything()["packet_size_bytes"]
    return found


def of_kind(name: str) -> dict[str, dict[str, float]]:
    """The thesis's figures of a kind of message by protocol: `packets` and `bytes` per message, the mean `delay_ms`,
    and the `loss` as a share. Empty for a kind that the thesis does not have."""
    printed = everything()["message_set"].get(name)
    if printed is None:
        return {}
    return {
        "packets": {p: count / MESSAGES for p, count in printed["packets"].items()},
        "bytes": {p: size * 1e6 / MESSAGES for p, size in printed["size_mb"].items()},
        "delay_ms": {p: float(ms) for p, ms in printed["delay_ms"].items()},
        "loss": {p: percent / 100 for p, percent in printed["loss_pct"].items()},
    }


def bytes_were_computed(name: str) -> bool:
    """Whether the thesis's MQTT-XT bytes for a kind of message are its packets times a constant."""
    printed = of_kind(name)
    return bool(printed) and round(printed["bytes"]["mqttxt"] / printed["packets"]["mqttxt"], 3) in _COMPUTED


def scenarios() -> tuple[str, ...]:
    """The experiments of the thesis, in its order."""
    return tuple(everything()["scenarios"])


def caveats(experiment: str) -> tuple[str, ...]:
    """The caveats on comparing with the thesis's figures of an experiment; empty if the thesis has none."""
    if experiment not in (MESSAGE_SET, *everything()["scenarios"]):
        return ()
    about = {"message_set", "packet_size"} if experiment == MESSAGE_SET else {"scenarios", experiment}
    return tuple(entry["text"] for entry in everything()["caveats"] if about & set(entry["about"]))
