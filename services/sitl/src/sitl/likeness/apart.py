"""Where the stand-in stays apart from PX4, and why."""

from __future__ import annotations

_DRIFTS = "PX4's estimate drifts by metres in minutes; the stand-in's errors stay about nothing, so that flights repeat"

APART: dict[tuple[str, str], str] = {
    ("goto and return", "goto at rest"): _DRIFTS,
    ("idle, onboard link", "relative_altitude_m"): _DRIFTS,
    ("idle, onboard link", "changes of home"): _DRIFTS,
    ("idle, onboard link", "largest jump of home_m"): _DRIFTS,
}
"""By case and the beginning of a fact's name."""
OF_ITSELF = (
    "With a fleet's capacity and charge a battery is an energy, not PX4's simulated one, which drains to 50 % in half "
    "a minute: rankings would have nothing to rank.",
    "Where PX4 main took a goto in MAV_FRAME_GLOBAL_INT alone, which was undone later, the stand-in takes the others.",
    "Parameters are those that change its flight, not PX4's thousand; there is no mission and no file to download.",
    "The land detector is a time on the ground, so a landing takes as long as the quicker half of PX4's.",
    "An offboard attitude is flown as a velocity.",
)
"""What no case tells."""


def reason(case: str, name: str) -> str | None:
    """Why a fact stays apart; None for one that has to agree."""
    return next((why for (at, what), why in APART.items() if at == case and name.startswith(what)), None)
