"""Requests the messages that the autopilot does not send, and requests them again when they stop.

ArduPilot sends next to nothing without a request, and a restart makes it forget the requests.
"""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from ..protocol.plans import PlanList
from ..protocol.states import Airframe, Home, MaxGroundspeed
from .mavlink.plans import AUTOPILOT_COMPONENT, command_long
from .mavlink.vehicle import SOURCES, Vehicle

PATIENCE_MS = 3000
SILENT_MS = 10_000
"""How long a message may stay away before it is requested again; PX4 sends the slowest every two seconds."""
_GAP_MS = (0, 1000, 2000, 5000, 10_000, 30_000)
"""Pauses between requests for the same thing; the last one repeats."""

_MESSAGES = {"home": mavlink.MAVLINK_MSG_ID_HOME_POSITION, "version": mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION}
"""Messages that are requested singly."""
_GPS_HZ = (mavlink.MAVLINK_MSG_ID_GPS_RAW_INT, 1)
_RATES_HZ = {
    "battery": (mavlink.MAVLINK_MSG_ID_BATTERY_STATUS, 0.5),
    "location": (mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, 5),
    "groundspeed": (mavlink.MAVLINK_MSG_ID_VFR_HUD, 4),
    "landed_state": (mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE, 5),
    "health": (mavlink.MAVLINK_MSG_ID_SYS_STATUS, 1),
    "mission": (mavlink.MAVLINK_MSG_ID_MISSION_CURRENT, 1),
    "fence": (mavlink.MAVLINK_MSG_ID_FENCE_STATUS, 1),
}


class Enquiries:
    """The requests to one autopilot. After its first heartbeat it has `PATIENCE_MS` to send streams unasked.

    Home is requested at once: PX4 sends it every two seconds, and no drone takes off without it. `asked_hz` gets the
    requested rates, by the kind of message.
    """

    def __init__(self, vehicle: Vehicle, asked_hz: dict[str, float] | None = None, all_states: bool = False) -> None:
        self._vehicle = vehicle
        self._all_states = all_states
        self._rates_hz = {**_RATES_HZ, "gps": _GPS_HZ} if all_states else _RATES_HZ
        self._streamed = {name: SOURCES[name] for name in (*self._rates_hz, "home")}
        self._asked_hz = {} if asked_hz is None else asked_hz
        self._asked: dict[str, tuple[int, int]] = {}
        self._first_ms: int | None = None

    def due(self, now_ms: int) -> list[Any]:
        """The MAVLink messages to send now."""
        if not self._vehicle.is_alive(now_ms):
            self._first_ms = None
            return []
        if self._first_ms is None:
            self._first_ms = now_ms
        alive_ms = now_ms - self._first_ms
        missing = self._missing_parameters()
        if self._vehicle.seen(Home) is None:
            missing.append("home")
        airframe = self._vehicle.seen(Airframe)
        if self._all_states and airframe is not None and airframe.version is None:
            missing.append("version")
        if alive_ms >= PATIENCE_MS:
            enough_ms = min(SILENT_MS, alive_ms)
            silent = self._vehicle.arrivals.silent(self._streamed, now_ms - enough_ms)
            if silent:
                passed_over = {*missing, *self._unwanted()}
                missing += [name for name in silent if name not in passed_over]
        if self._asked:
            self._asked = {name: asked for name, asked in self._asked.items() if name in missing}
        return [self._question(name) for name in missing if self._is_due(name, now_ms)]

    def _unwanted(self) -> list[str]:
        """Streams not to request: a plan's progress, until a station has asked for the plan."""
        known = self._vehicle.mission.hashes
        tells = PlanList.FENCE in known and self._vehicle.autopilot.tells_of_fence
        return [name for name, is_wanted in (("mission", bool(known)), ("fence", tells)) if not is_wanted]

    def _missing_parameters(self) -> list[str]:
        """The needed parameters, which no stream carries."""
        autopilot = self._vehicle.autopilot
        speeds = [] if self._vehicle.seen(MaxGroundspeed) else [*autopilot.max_speed]
        return speeds + ([] if self._vehicle.cruise_m_s is not None else [*autopilot.cruise_speed])

    def _is_due(self, name: str, now_ms: int) -> bool:
        count, next_ms = self._asked.get(name, (0, 0))
        if now_ms < next_ms:
            return False
        gap = _GAP_MS[min(count + 1, len(_GAP_MS) - 1)]
        self._asked[name] = (count + 1, now_ms + gap)
        return True

    def _question(self, name: str) -> Any:
        if name in _MESSAGES:
            return command_long(self._vehicle, mavlink.MAV_CMD_REQUEST_MESSAGE, float(_MESSAGES[name]))
        if name in self._rates_hz:
            message_id, rate_hz = self._rates_hz[name]
            self._asked_hz[SOURCES[name]] = rate_hz
            return command_long(self._vehicle, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, float(message_id), 1e6 / rate_hz)
        system = self._vehicle.system_id
        return mavlink.MAVLink_param_request_read_message(system, AUTOPILOT_COMPONENT, name.encode(), param_index=-1)
