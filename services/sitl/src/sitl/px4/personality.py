"""The stand-in as PX4, behind the interface that all kinds have."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pymavlink.dialects.v20 import development as mavlink

from ..answers import ACCEPTED, DENIED, FAILED
from ..dynamics import Energy, SimulatedBattery
from ..fleet import DroneConfig
from ..outputs import Output
from ..parameters import BytewiseParameters, Parameters
from ..personality import Personality
from . import commands
from .autopilot import Px4
from .logs import Px4LogLink
from .parameters import SPECS
from .plans import Px4PlanLink
from .streams import SILENT, rates_hz
from .telemetry import Px4Telemetry

NOMINAL_V = 14.8
"""A 4S lithium polymer battery, for BAT1_CAPACITY in mAh."""


class _Px4(Personality[Px4]):
    name = "px4"
    title = "PX4"
    release = 1 << 24 | 15 << 16 | 4 << 8 | 255
    silent = SILENT
    no_interval, no_interval_told, no_message = FAILED, ACCEPTED, DENIED
    tells_modes_at_once = False
    answers_pings = True
    unsigned = frozenset(
        {
            mavlink.MAVLINK_MSG_ID_HEARTBEAT,
            mavlink.MAVLINK_MSG_ID_RADIO_STATUS,
            mavlink.MAVLINK_MSG_ID_ADSB_VEHICLE,
            mavlink.MAVLINK_MSG_ID_COLLISION,
        }
    )

    def rates_hz(self, chosen: str) -> Mapping[str, float]:
        return rates_hz(chosen)

    def parameters(self, config: DroneConfig) -> Parameters:
        own: dict[str, float] = {"MAV_SYS_ID": config.system_id}
        if config.capacity_wh is not None:
            own["BAT1_CAPACITY"] = config.capacity_wh / NOMINAL_V * 1000
        return BytewiseParameters(SPECS, {**config.parameters, **own})

    def battery(self, parameters: Parameters) -> Energy:
        return SimulatedBattery(parameters["SIM_BAT_DRAIN"], parameters["SIM_BAT_MIN_PCT"])

    def autopilot(self, config: DroneConfig, battery: Energy, parameters: Parameters) -> Px4:
        return Px4(config.system_id, config.home, battery, parameters)

    def telemetry(self, autopilot: Px4, seed: int, *, quiet: bool) -> Px4Telemetry:
        return Px4Telemetry(autopilot, seed, quiet=quiet)

    def plan_link(self, autopilot: Px4) -> Px4PlanLink:
        return Px4PlanLink(autopilot.plans, autopilot.say)

    def log_link(self, autopilot: Px4) -> Px4LogLink:
        return Px4LogLink(autopilot.logs, lambda: autopilot.armed, autopilot.say)

    def handle(self, autopilot: Px4, message: Any) -> list[Output]:
        return commands.handle(autopilot, message)


PX4 = _Px4()
