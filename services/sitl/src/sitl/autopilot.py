"""The autopilot: modes, arming rules, flight and what it answers to commands; no I/O, time is an argument."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from .dynamics import Battery, Motion, Place, approach
from .parameters import Parameters

STEP_S = 0.02
FORCE = 21196.0
"""param2 of MAV_CMD_COMPONENT_ARM_DISARM that forces it."""
FULL_STOP_M = 0.3


class Mode(Enum):
    """PX4's modes as (main, sub) of custom_mode."""

    MANUAL = (1, 0)
    ALTITUDE = (2, 0)
    POSITION = (3, 0)
    TAKEOFF = (4, 2)
    HOLD = (4, 3)
    MISSION = (4, 4)
    RETURN = (4, 5)
    LAND = (4, 6)
    ACRO = (5, 0)
    OFFBOARD = (6, 0)
    STABILIZED = (7, 0)

    @property
    def custom_mode(self) -> int:
        return self.value[0] << 16 | self.value[1] << 24


@dataclass(frozen=True)
class Happened:
    """Something for the events file."""

    event: str
    detail: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Reply:
    """A MAVLink message to send, at once and outside the streams."""

    message: Any


Output = Happened | Reply


@dataclass
class SetPoint:
    """What an offboard controller last asked for: a velocity (north, east, up) or a position."""

    at_s: float
    velocity: tuple[float, float, float] | None = None
    position: tuple[float, float, float] | None = None


class Autopilot:
    """One multicopter. `step` moves time on; `handle` takes MAVLink messages; both return what follows."""

    def __init__(self, system_id: int, home: Place, battery: Battery, parameters: Parameters) -> None:
        self.system_id = system_id
        self.origin = home
        self.home = home
        self.parameters = parameters
        self.battery = battery
        self.motion = Motion()
        self.mode = Mode.HOLD
        self.armed = False
        self.healthy = True
        self.landed = True
        self.now_s = 0.0
        self.target = (0.0, 0.0, 0.0)
        self.set_point: SetPoint | None = None
        self._armed_s = 0.0
        self._landed_s = 0.0
        self._flown = False
        self._returning_home = False
        self._out: list[Output] = []

    @property
    def place(self) -> Place:
        return self.origin.offset(*self.motion.position)

    @property
    def home_up_m(self) -> float:
        """Home's height over the origin."""
        return self.home.altitude_m - self.origin.altitude_m

    @property
    def landed_state(self) -> int:
        if self.landed:
            return int(mavlink.MAV_LANDED_STATE_ON_GROUND)
        if self.mode is Mode.TAKEOFF:
            return int(mavlink.MAV_LANDED_STATE_TAKEOFF)
        return int(mavlink.MAV_LANDED_STATE_LANDING if self.mode is Mode.LAND else mavlink.MAV_LANDED_STATE_IN_AIR)

    def step(self, dt_s: float = STEP_S) -> list[Output]:
        """Fly on for `dt_s`."""
        self.now_s += dt_s
        if self.armed:
            wanted = self._wanted_velocity()
            self.motion.step(wanted, self.parameters["MPC_ACC_HOR"], dt_s)
            self._notice_ground()
        self.battery.step(self.motion, self.armed and not self.landed, dt_s)
        self._disarm_when_due()
        return self._take_out()

    def handle(self, message: Any) -> list[Output]:
        """Answer a message that is for this system."""
        kind = message.get_type()
        if kind in ("COMMAND_LONG", "COMMAND_INT"):
            detail = {"command": message.command, "params": _params(message)}
            self._out.append(Happened("command", detail))
            result = self._command(message)
            self._out.insert(1, Reply(_ack(message, result)))
        elif kind == "SET_MODE":
            self._set_mode(message.custom_mode >> 16 & 0xFF, message.custom_mode >> 24 & 0xFF)
        elif kind == "SET_POSITION_TARGET_LOCAL_NED":
            self._on_position_target(message)
        elif kind == "SET_ATTITUDE_TARGET":
            self._on_attitude_target(message)
        return self._take_out()

    def pilot(self, mode: Mode) -> list[Output]:
        """A pilot's hand: change the mode without asking."""
        self._enter(mode)
        return self._take_out()

    def put_back(self, *, altitude_m: float = 0.0, armed: bool = False) -> list[Output]:
        """Into a starting state for an experiment: at home, in hold, on the ground or hovering."""
        self.motion = Motion(position=[0.0, 0.0, altitude_m])
        self.landed = altitude_m <= 0
        self._flown = not self.landed
        self.target = (0.0, 0.0, altitude_m)
        self._set_armed(armed or not self.landed)
        self._enter(Mode.HOLD)
        return self._take_out()

    def _take_out(self) -> list[Output]:
        out, self._out = self._out, []
        return out

    # -- flight ---------------------------------------------------------------------------------------------

    def _wanted_velocity(self) -> tuple[float, float, float]:
        if self.landed and self.mode not in (Mode.TAKEOFF, Mode.OFFBOARD):
            return 0.0, 0.0, 0.0
        if self.mode is Mode.TAKEOFF:
            return self._take_off()
        if self.mode is Mode.LAND:
            return 0.0, 0.0, -self._descent_m_s()
        if self.mode is Mode.RETURN:
            return self._fly_home()
        if self.mode is Mode.OFFBOARD:
            return self._offboard()
        return self._towards(self.target)

    def _take_off(self) -> tuple[float, float, float]:
        left_m = self.target[2] - self.motion.position[2]
        if left_m < FULL_STOP_M:
            self._enter(Mode.HOLD)
            return 0.0, 0.0, 0.0
        return 0.0, 0.0, approach(left_m, self.parameters["MPC_TKO_SPEED"], 2.0)

    def _descent_m_s(self) -> float:
        """Slowing from the auto descent to the landing speed between MPC_LAND_ALT1 and MPC_LAND_ALT2."""
        fast, slow = self.parameters["MPC_Z_V_AUTO_DN"], self.parameters["MPC_LAND_SPEED"]
        high, low = self.parameters["MPC_LAND_ALT1"], self.parameters["MPC_LAND_ALT2"]
        share = (self.motion.position[2] - self.home_up_m - low) / (high - low)
        return slow + (fast - slow) * max(0.0, min(1.0, share))

    def _fly_home(self) -> tuple[float, float, float]:
        north, east = self.origin.metres_to(self.home.latitude_deg, self.home.longitude_deg)
        height = self.home_up_m + self.parameters["RTL_RETURN_ALT"]
        away = math.hypot(north - self.motion.position[0], east - self.motion.position[1])
        if self._returning_home or away > 1.0:
            up = self.motion.position[2]
            if not self._returning_home and up < height - FULL_STOP_M:
                return self._towards((self.motion.position[0], self.motion.position[1], height))
            self._returning_home = True
            if away > FULL_STOP_M or self.motion.groundspeed_m_s > 0.2:
                return self._towards((north, east, max(up, height)))
        return 0.0, 0.0, -self._descent_m_s()

    def _offboard(self) -> tuple[float, float, float]:
        point = self.set_point
        if point is None or self.now_s - point.at_s > self.parameters["COM_OF_LOSS_T"]:
            self._text("Offboard control lost, holding")
            self._enter(Mode.HOLD)
            return 0.0, 0.0, 0.0
        if point.velocity is not None:
            most = self.parameters["MPC_XY_VEL_MAX"]
            size = math.hypot(point.velocity[0], point.velocity[1])
            scale = min(1.0, most / size) if size > 0 else 1.0
            return point.velocity[0] * scale, point.velocity[1] * scale, point.velocity[2]
        assert point.position is not None
        return self._towards(point.position)

    def _towards(self, target: tuple[float, float, float]) -> tuple[float, float, float]:
        north, east = target[0] - self.motion.position[0], target[1] - self.motion.position[1]
        distance = math.hypot(north, east)
        fastest = min(self.parameters["MPC_XY_CRUISE"], self.parameters["MPC_XY_VEL_MAX"])
        speed = approach(distance, fastest, self.parameters["MPC_ACC_HOR"])
        up = target[2] - self.motion.position[2]
        limit = self.parameters["MPC_Z_V_AUTO_UP" if up > 0 else "MPC_Z_V_AUTO_DN"]
        share = speed / distance if distance > 1e-6 else 0.0
        return north * share, east * share, approach(up, limit, 2.0)

    def _notice_ground(self) -> None:
        on_ground = self.motion.position[2] <= 0.0
        if self.landed and not on_ground:
            self.landed, self._flown = False, True
            self._out.append(Happened("took_off"))
        elif not self.landed and on_ground:
            self.landed, self._landed_s = True, self.now_s
            self._out.append(Happened("landed"))

    def _disarm_when_due(self) -> None:
        if not self.armed or not self.landed:
            return
        if self._flown:
            due_s = self._landed_s + self.parameters["COM_DISARM_LAND"]
        else:
            due_s = self._armed_s + self.parameters["COM_DISARM_PRFLT"]
        if self.now_s >= due_s:
            self._set_armed(False)

    # -- commands -------------------------------------------------------------------------------------------

    def _command(self, message: Any) -> int:
        handler = _COMMANDS.get(message.command)
        if handler is None:
            return int(mavlink.MAV_RESULT_UNSUPPORTED)
        return handler(self, message)

    def _arm_disarm(self, message: Any) -> int:
        if message.param1 > 0.5:
            if self.armed:
                return int(mavlink.MAV_RESULT_ACCEPTED)
            if not self.healthy:
                return self._deny("Arming denied: system not ready")
            if self.battery.remaining_pct < 7:
                return self._deny("Arming denied: low battery")
            self.home = self.place
            self._armed_s, self._flown = self.now_s, False
            self._set_armed(True)
            self._out.append(Reply(self.home_position()))
            return int(mavlink.MAV_RESULT_ACCEPTED)
        if self.armed and not self.landed and message.param2 != FORCE:
            return self._deny("Disarming denied: not landed")
        self._set_armed(False)
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def _takeoff(self, message: Any) -> int:
        if not self.armed:
            return self._deny("Takeoff denied: disarm state")
        if not self.landed:
            return self._deny("Takeoff denied: already in air")
        z = _z(message)
        default = self.home_up_m + self.parameters["MIS_TAKEOFF_ALT"]
        up = default if math.isnan(z) else self._up(message, z)
        self.target = (self.motion.position[0], self.motion.position[1], up)
        self._enter(Mode.TAKEOFF)
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def _land(self, message: Any) -> int:
        self._enter(Mode.LAND)
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def _reposition(self, message: Any) -> int:
        if not self.armed or self.landed:
            return self._deny("Reposition rejected: not flying")
        if message.get_type() == "COMMAND_INT":
            latitude, longitude = message.x / 1e7, message.y / 1e7
        else:
            latitude, longitude = message.param5, message.param6
        if not (-90 <= latitude <= 90 and -180 <= longitude <= 180):
            return self._deny("Reposition rejected: position is not valid")
        if self.mode not in (Mode.HOLD, Mode.TAKEOFF) and not int(message.param2) & 1:
            return self._deny("Reposition rejected: not in hold")
        z = _z(message)
        up = self.motion.position[2] if math.isnan(z) else self._up(message, z)
        north, east = self.origin.metres_to(latitude, longitude)
        self._enter(Mode.HOLD)
        self.target = (north, east, up)
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def _do_set_mode(self, message: Any) -> int:
        if not int(message.param1) & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            return self._deny("Mode change denied: custom mode expected")
        return self._set_mode(int(message.param2), int(message.param3))

    def _set_mode(self, main: int, sub: int) -> int:
        try:
            mode = Mode((main, sub))
        except ValueError:
            return self._deny(f"Unknown mode {main} {sub}")
        if mode is Mode.OFFBOARD and (
            self.set_point is None or self.now_s - self.set_point.at_s > self.parameters["COM_OF_LOSS_T"]
        ):
            return self._deny("Switching to offboard is not possible: no set-point")
        if mode is Mode.TAKEOFF:
            up = self.home_up_m + self.parameters["MIS_TAKEOFF_ALT"]
            self.target = (self.motion.position[0], self.motion.position[1], up)
        self._enter(mode)
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def _up(self, message: Any, z: float) -> float:
        """A command's altitude over the origin; only COMMAND_INT names a frame, COMMAND_LONG is AMSL."""
        relative = (mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT)
        if message.get_type() == "COMMAND_INT" and message.frame in relative:
            return self.home_up_m + z
        return z - self.origin.altitude_m

    def _enter(self, mode: Mode) -> None:
        if mode is Mode.HOLD and self.mode is not Mode.TAKEOFF:
            self.target = (self.motion.position[0], self.motion.position[1], self.motion.position[2])
        if mode is not self.mode:
            self._returning_home = False
            self.mode = mode
            self._out += [Happened("mode", {"mode": mode.name.lower()}), Reply(self.heartbeat())]

    def _set_armed(self, armed: bool) -> None:
        if armed != self.armed:
            self.armed = armed
            self._out += [Happened("armed" if armed else "disarmed"), Reply(self.heartbeat())]

    def _deny(self, why: str) -> int:
        self._text(why)
        return int(mavlink.MAV_RESULT_DENIED)

    def _text(self, text: str) -> None:
        self._out.append(Reply(mavlink.MAVLink_statustext_message(mavlink.MAV_SEVERITY_CRITICAL, text.encode()[:50])))

    def _on_position_target(self, message: Any) -> None:
        if message.type_mask & 0b111000 == 0:  # velocity is not ignored
            self.set_point = SetPoint(self.now_s, velocity=(message.vx, message.vy, -message.vz))
        else:
            self.set_point = SetPoint(self.now_s, position=(message.x, message.y, -message.z))

    def _on_attitude_target(self, message: Any) -> None:
        """Tilt becomes horizontal speed, thrust around hover becomes climb: enough for a link's experiment."""
        w, x, y, z = message.q
        roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
        pitch = math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x))))
        yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        forward, right = -math.sin(pitch) * 10, math.sin(roll) * 10
        north = forward * math.cos(yaw) - right * math.sin(yaw)
        east = forward * math.sin(yaw) + right * math.cos(yaw)
        self.set_point = SetPoint(self.now_s, velocity=(north, east, (message.thrust - 0.5) * 6))

    # -- messages outside the streams -----------------------------------------------------------------------

    def heartbeat(self) -> Any:
        base = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        if self.armed:
            base |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        state = mavlink.MAV_STATE_ACTIVE if self.armed else mavlink.MAV_STATE_STANDBY
        kind = int(self.parameters["MAV_TYPE"])
        return mavlink.MAVLink_heartbeat_message(kind, mavlink.MAV_AUTOPILOT_PX4, base, self.mode.custom_mode, state, 3)

    def home_position(self) -> Any:
        north, east = self.origin.metres_to(self.home.latitude_deg, self.home.longitude_deg)
        return mavlink.MAVLink_home_position_message(
            round(self.home.latitude_deg * 1e7),
            round(self.home.longitude_deg * 1e7),
            round(self.home.altitude_m * 1000),
            north,
            east,
            -self.home_up_m,
            [1.0, 0.0, 0.0, 0.0],
            0.0,
            0.0,
            0.0,
            round(self.now_s * 1e6),
        )


def _params(message: Any) -> list[float | None]:
    """The seven parameters as they came, COMMAND_INT's positions as integers; None for NaN."""
    first = [message.param1, message.param2, message.param3, message.param4]
    last = [message.x, message.y, message.z] if message.get_type() == "COMMAND_INT" else _long_position(message)
    return [None if math.isnan(param) else param for param in (*first, *last)]


def _long_position(message: Any) -> list[float]:
    return [message.param5, message.param6, message.param7]


def _z(message: Any) -> float:
    return float(message.z if message.get_type() == "COMMAND_INT" else message.param7)


def _ack(message: Any, result: int) -> Any:
    return mavlink.MAVLink_command_ack_message(
        message.command, result, 0, 0, message.get_srcSystem(), message.get_srcComponent()
    )


_COMMANDS: dict[int, Callable[[Autopilot, Any], int]] = {
    mavlink.MAV_CMD_COMPONENT_ARM_DISARM: Autopilot._arm_disarm,
    mavlink.MAV_CMD_NAV_TAKEOFF: Autopilot._takeoff,
    mavlink.MAV_CMD_NAV_LAND: Autopilot._land,
    mavlink.MAV_CMD_DO_REPOSITION: Autopilot._reposition,
    mavlink.MAV_CMD_DO_SET_MODE: Autopilot._do_set_mode,
}
