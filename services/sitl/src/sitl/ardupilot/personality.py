"""The stand-in as ArduCopter, behind the interface that all kinds have."""

from __future__ import annotations

from collections.abc import Mapping

from pymavlink.dialects.v20 import development as mavlink

from ..answers import DENIED, FAILED
from ..dynamics import Battery, Energy
from ..fleet import DroneConfig
from ..parameters import Parameters
from ..personality import Personality
from .autopilot import ArduCopter
from .commands import handle
from .logs import CopterLogLink
from .parameters import SPECS, of_fleet
from .plans import CopterPlanLink
from .telemetry import CopterTelemetry

NOMINAL_V = 12.6
"""A 3S lithium polymer battery, for BATT_CAPACITY in mAh."""
HOVER_W = 350.0
RADIO = 166
"""RADIO of ardupilotmega.xml, the status of a SiK radio."""
SILENT = frozenset(
    getattr(mavlink, f"MAVLINK_MSG_ID_{name}") for name in ("RAW_IMU", "SCALED_IMU2", "SCALED_IMU3", "GPS2_RAW")
)


class _ArduCopter(Personality):
    name = "ardupilot"
    title = "ArduPilot"
    release = 4 << 24 | 6 << 16
    silent = SILENT
    no_interval, no_interval_told, no_message = DENIED, FAILED, FAILED
    tells_modes_at_once = True
    answers_pings = False
    unsigned = frozenset({mavlink.MAVLINK_MSG_ID_RADIO_STATUS, RADIO})
    autopilot = ArduCopter
    telemetry = CopterTelemetry
    plan_link = CopterPlanLink
    log_link = CopterLogLink
    handle = staticmethod(handle)

    def rates_hz(self, chosen: str) -> Mapping[str, float]:
        """Only heartbeats until others are requested, whatever is chosen: the sets are PX4's."""
        return {name: 1.0 if name == "HEARTBEAT" else 0.0 for name in CopterTelemetry.makers}

    def parameters(self, config: DroneConfig) -> Parameters:
        own: dict[str, float] = {"SYSID_THISMAV": config.system_id}
        if config.capacity_wh is not None:
            own["BATT_CAPACITY"] = config.capacity_wh / NOMINAL_V * 1000
        return Parameters(SPECS, {**of_fleet(config), **own})

    def battery(self, parameters: Parameters) -> Energy:
        capacity_wh = parameters["BATT_CAPACITY"] / 1000 * NOMINAL_V
        return Battery(capacity_wh, capacity_wh, idle_w=0.0, hover_w=HOVER_W, volts=(NOMINAL_V, NOMINAL_V))


ARDUCOPTER = _ArduCopter()
