"""The stand-in as PX4, behind the interface that all kinds have."""

from __future__ import annotations

from collections.abc import Mapping

from pymavlink.dialects.v20 import development as mavlink

from ..answers import ACCEPTED, DENIED, FAILED
from ..dynamics import Energy, SimulatedBattery
from ..fleet import DroneConfig
from ..parameters import BytewiseParameters, Parameters
from ..personality import Personality
from .autopilot import Px4
from .commands import handle
from .logs import Px4LogLink
from .parameters import SPECS
from .plans import Px4PlanLink
from .streams import SILENT, rates_hz
from .telemetry import Px4Telemetry

NOMINAL_V = 14.8
"""A 4S lithium polymer battery, for BAT1_CAPACITY in mAh."""


class _Px4(Personality):
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
    autopilot = Px4
    telemetry = Px4Telemetry
    plan_link = Px4PlanLink
    log_link = Px4LogLink
    handle = staticmethod(handle)

    def rates_hz(self, chosen: str) -> Mapping[str, float]:
        return rates_hz(chosen)

    def parameters(self, config: DroneConfig) -> Parameters:
        own: dict[str, float] = {"MAV_SYS_ID": config.system_id}
        if config.capacity_wh is not None:
            own["BAT1_CAPACITY"] = config.capacity_wh / NOMINAL_V * 1000
        return BytewiseParameters(SPECS, {**config.parameters, **own})

    def battery(self, parameters: Parameters) -> Energy:
        return SimulatedBattery(parameters["SIM_BAT_DRAIN"], parameters["SIM_BAT_MIN_PCT"])


PX4 = _Px4()
