"""The options of one drone's UAV client."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..errors import ConfigurationError
from .mavlink.guarded_parameters import GUARDED as GUARDED_PARAMETERS
from .mavlink.guarded_parameters import is_guarded
from .mavlink.raw import GUARDED, Limits
from .mavlink.sources import COMMANDING

SHORTEST_S, LONGEST_S = 60, 86_400


@dataclass(frozen=True)
class UavOptions:
    """`endurance_s`: how long a full battery lasts in flight; None: it is measured. `limits`: of raw MAV_CMDs.

    `carries_sensors`: the client has a broker for sensors and carries their readings. `all_states`: it also publishes
    the states that are on request (R3.11). `keeps_logs`: it has a folder for the autopilot's logs.
    Raises ConfigurationError for an invalid value.
    """

    endurance_s: int | None = None
    limits: Limits = field(default_factory=Limits)
    carries_sensors: bool = False
    all_states: bool = False
    keeps_logs: bool = False

    def __post_init__(self) -> None:
        if self.endurance_s is not None and not SHORTEST_S <= self.endurance_s <= LONGEST_S:
            raise ConfigurationError(
                f"--endurance-s {self.endurance_s}: expected seconds from {SHORTEST_S} to {LONGEST_S}"
            )
        for number in self.limits.mav_cmds - GUARDED.keys():
            raise ConfigurationError(
                f"--allow-mav-cmd {number}: expected one that is guarded: {', '.join(map(str, sorted(GUARDED)))}"
            )
        for name in self.limits.parameters:
            if not is_guarded(name):
                raise ConfigurationError(
                    f"--allow-parameter {name}: expected one that is guarded: {', '.join(sorted(GUARDED_PARAMETERS))}"
                )
        for component in self.limits.components:
            own = [source.component for source in COMMANDING]
            if not 2 <= component <= 255 or component in own:
                raise ConfigurationError(
                    f"--allow-component {component}: expected 2 to 255, not {min(own)} to {max(own)}"
                )
