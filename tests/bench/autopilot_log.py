"""Flies a PX4 that runs on loopback, and records the messages behind its states, thinned, for tests.

`python -m tests.bench.autopilot_log PORT NAME FILE`: its onboard link sends to PORT. A minute of rest
since its first heartbeat; arm, takeoff 10 m, hold, goto 100 m north, return, land; half a minute of rest.
"""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pymavlink import mavutil
from pymavlink.dialects.v20 import common as mavlink

FIELDS = {
    "HEARTBEAT": ("type", "autopilot", "base_mode", "custom_mode"),
    "BATTERY_STATUS": ("battery_remaining",),
    "GLOBAL_POSITION_INT": ("lat", "lon", "alt", "relative_alt", "hdg"),
    "VFR_HUD": ("groundspeed",),
    "EXTENDED_SYS_STATE": ("landed_state",),
    "HOME_POSITION": ("latitude", "longitude", "altitude"),
    "SYS_STATUS": (
        "onboard_control_sensors_present",
        "onboard_control_sensors_enabled",
        "onboard_control_sensors_health",
    ),
}
"""The fields from which the states are read; all others are left out."""
EVERY_S = {"GLOBAL_POSITION_INT": 0.5, "VFR_HUD": 1.0}
SELDOM = frozenset({"EXTENDED_SYS_STATE", "SYS_STATUS"})
"""Kinds of which only changes are kept; of all others every message is."""
REST_S, HOLD_S, AFTER_S = 60.0, 15.0, 30.0
STEP_S = 120.0
HEIGHT_M, NORTH_DEG = 10.0, 100 / 111_195
NEAR_DEG = 2e-5
NAN = math.nan


class Flight:
    """The connection, the last message of each kind, and the rows so far: milliseconds, kind, values."""

    def __init__(self, port: int) -> None:
        self._link = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port}", source_component=191, dialect="common")
        self._began_s = time.monotonic()
        self._heartbeat_s = -math.inf
        self._kept: dict[str, tuple[float, list[Any]]] = {}
        self.last: dict[str, Any] = {}
        self.rows: list[list[Any]] = []

    def listen(self, seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Listen for `seconds`, or until a condition holds; returns whether it holds."""
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s and not until():
            if time.monotonic() - self._heartbeat_s >= 1:
                self._heartbeat_s = time.monotonic()
                self._link.mav.heartbeat_send(
                    mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4
                )
            message = self._link.recv_match(blocking=True, timeout=0.1)
            if message is not None and message.get_srcComponent() == mavlink.MAV_COMP_ID_AUTOPILOT1:
                self.last[message.get_type()] = message
                self._keep(message)
        return until()

    def command(self, number: int, *params: float) -> None:
        """Send a command until it is accepted; exits if it never is."""
        for _ in range(30):
            self.last.pop("COMMAND_ACK", None)
            self._link.mav.command_long_send(self._link.target_system, 1, number, 0, *params, *[0] * (7 - len(params)))
            self.listen(2, lambda: "COMMAND_ACK" in self.last)
            if "COMMAND_ACK" in self.last and self.last["COMMAND_ACK"].result == mavlink.MAV_RESULT_ACCEPTED:
                return
            self.listen(1)
        raise SystemExit(f"MAV_CMD {number} was not accepted")

    def goto(self, latitude_deg: float, longitude_deg: float, altitude_m: float) -> None:
        target = self._link.target_system, 1
        for frame in (mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_FRAME_GLOBAL_INT):  # each is refused by some versions
            place = round(latitude_deg * 1e7), round(longitude_deg * 1e7), altitude_m
            self._link.mav.command_int_send(*target, frame, mavlink.MAV_CMD_DO_REPOSITION, 0, 0, -1, 1, 0, NAN, *place)

    def wait(self, what: str, until: Callable[[], bool]) -> None:
        if not self.listen(STEP_S, until):
            raise SystemExit(f"{what}: not within {STEP_S:.0f} s")

    def _keep(self, message: Any) -> None:
        kind, now_s = message.get_type(), time.monotonic() - self._began_s
        if kind not in FIELDS or (kind == "BATTERY_STATUS" and message.id != 0):
            return
        values = [getattr(message, name) for name in FIELDS[kind]]
        at_s, before = self._kept.get(kind, (-math.inf, []))
        if now_s - at_s < EVERY_S.get(kind, 0) or (kind in SELDOM and values == before):
            return
        self._kept[kind] = now_s, values
        self.rows.append([round(now_s * 1000), kind, *(round(v, 2) if isinstance(v, float) else v for v in values)])


def fly(flight: Flight) -> None:
    flight.wait("a heartbeat", lambda: "HEARTBEAT" in flight.last)
    flight.listen(REST_S)
    flight.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    flight.wait("arm", lambda: bool(flight.last["HEARTBEAT"].base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED))
    place = flight.last["GLOBAL_POSITION_INT"]
    latitude_deg, longitude_deg = place.lat / 1e7, place.lon / 1e7
    target_m = (place.alt - place.relative_alt) / 1000 + HEIGHT_M
    flight.command(mavlink.MAV_CMD_NAV_TAKEOFF, NAN, NAN, NAN, NAN, NAN, NAN, target_m)
    flight.wait("takeoff", lambda: bool(flight.last["GLOBAL_POSITION_INT"].alt / 1000 > target_m - 0.5))
    flight.listen(HOLD_S)
    there_deg = latitude_deg + NORTH_DEG
    flight.goto(there_deg, longitude_deg, target_m)
    flight.wait("goto", lambda: abs(flight.last["GLOBAL_POSITION_INT"].lat / 1e7 - there_deg) < NEAR_DEG)
    flight.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 4, 5)
    flight.listen(HOLD_S)
    flight.command(mavlink.MAV_CMD_NAV_LAND, NAN, NAN, NAN, NAN, NAN, NAN, NAN)
    flight.wait("land", lambda: not flight.last["HEARTBEAT"].base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
    flight.listen(AFTER_S)


def main(port: str, name: str, path: str) -> None:
    flight = Flight(int(port))
    fly(flight)
    rows = ",\n".join(json.dumps(row, separators=(",", ":")) for row in flight.rows)
    fields = json.dumps(FIELDS)
    Path(path).write_text(f'{{"autopilot": {json.dumps(name)}, "fields": {fields}, "rows": [\n{rows}\n]}}\n')


if __name__ == "__main__":
    main(*sys.argv[1:])
