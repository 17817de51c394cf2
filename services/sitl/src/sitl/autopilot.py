"""The autopilot's state: armed or not, in which mode, on the ground or flying; no I/O, time moves by `step`."""

from __future__ import annotations

from pymavlink.dialects.v20 import development as mavlink

from .dynamics import Battery, Motion, Place
from .guidance import FALL_M_S, Guidance
from .modes import Happened, Mode, Output, Reply
from .parameters import Parameters

STEP_S = 0.02
LOW_BATTERY_PCT = 7.0
"""COM_ARM_BAT_MIN is off in PX4; below its emergency level (BAT_EMERGEN_THR, 5 %, and some) nobody should start."""
_ON_GROUND, _IN_AIR = int(mavlink.MAV_LANDED_STATE_ON_GROUND), int(mavlink.MAV_LANDED_STATE_IN_AIR)
_LANDED_STATES = {Mode.TAKEOFF: int(mavlink.MAV_LANDED_STATE_TAKEOFF), Mode.LAND: int(mavlink.MAV_LANDED_STATE_LANDING)}


class Autopilot:
    """One multicopter. What changes by itself comes out of `step`, what a caller changes out of `take_out`."""

    def __init__(self, system_id: int, home: Place, battery: Battery, parameters: Parameters) -> None:
        self.system_id = system_id
        self.parameters = parameters
        self.battery = battery
        self.guidance = Guidance(home, parameters)
        self.mode = Mode.HOLD
        self.armed = False
        self.healthy = True
        self.landed = True
        self.now_s = 0.0
        self._armed_s = 0.0
        self._landed_s = 0.0
        self._flown = False
        self._out: list[Output] = []

    @property
    def motion(self) -> Motion:
        return self.guidance.motion

    @property
    def landed_state(self) -> int:
        """MAV_LANDED_STATE."""
        return _ON_GROUND if self.landed else _LANDED_STATES.get(self.mode, _IN_AIR)

    def step(self, dt_s: float = STEP_S) -> list[Output]:
        """Fly on for `dt_s`."""
        self.now_s += dt_s
        if self.armed:
            self._end_modes()
            wanted = self.guidance.wanted_velocity(self.mode, self.landed)
            self.motion.step(wanted, self.parameters["MPC_ACC_HOR"], dt_s)
        elif not self.landed:
            self.motion.step((0.0, 0.0, FALL_M_S), self.parameters["MPC_ACC_HOR"], dt_s)
        self._notice_ground()
        self.battery.step(self.motion, self.armed and not self.landed, dt_s)
        self._disarm_when_due()
        return self.take_out()

    def take_out(self) -> list[Output]:
        """What followed from the calls since the last time, in order."""
        out, self._out = self._out, []
        return out

    def _end_modes(self) -> None:
        """A takeoff ends in hold at its height, an offboard flight in hold when its controller is silent."""
        if self.mode is Mode.TAKEOFF and self.guidance.takeoff_done():
            target = self.guidance.target
            self.enter(Mode.HOLD)
            self.guidance.target = target
        elif self.mode is Mode.OFFBOARD and not self.guidance.has_set_point(self.now_s):
            self.say("Offboard control lost, holding")
            self.enter(Mode.HOLD)

    def _notice_ground(self) -> None:
        on_ground = self.motion.position[2] <= 0.0
        if self.landed and not on_ground:
            self.landed, self._flown = False, True
            self._out.append(Happened("took_off"))
        elif not self.landed and on_ground:
            self.landed, self._landed_s = True, self.now_s
            self._out.append(Happened("landed"))

    def _disarm_when_due(self) -> None:
        """COM_DISARM_LAND after a landing, COM_DISARM_PRFLT after arming; 0 or less turns either off."""
        if not self.armed or not self.landed:
            return
        name, since_s = ("COM_DISARM_LAND", self._landed_s) if self._flown else ("COM_DISARM_PRFLT", self._armed_s)
        after_s = self.parameters[name]
        if 0 < after_s <= self.now_s - since_s:
            self.disarm()

    # -- what callers change --------------------------------------------------------------------------------

    def arm_refusal(self) -> str | None:
        """Why arming is denied now, if it is."""
        if not self.healthy:
            return "Arming denied: system not ready"
        if self.battery.remaining_pct < LOW_BATTERY_PCT:
            return "Arming denied: low battery"
        return None

    def arm(self) -> None:
        """Home is where the drone is armed."""
        if not self.armed:
            self.guidance.home = self.guidance.place
            self._armed_s, self._flown = self.now_s, not self.landed
            self._set_armed(True)
            self._out.append(Reply(self.home_position()))

    def disarm(self) -> None:
        self._set_armed(False)

    def enter(self, mode: Mode) -> None:
        """Change the mode, as a pilot can at any time; hold aims at where the drone can stop."""
        if mode is Mode.HOLD:
            self.guidance.stop_here()
        if mode is not self.mode:
            self.mode = mode
            self._out += [Happened("mode", {"mode": mode.name.lower()}), Reply(self.heartbeat())]

    def put_back(self, *, altitude_m: float, armed: bool) -> None:
        """Into a starting state for an experiment: at home, in hold, on the ground or hovering (then always armed)."""
        self.guidance.motion = Motion(position=[0.0, 0.0, altitude_m])
        self.guidance.home = self.guidance.origin
        self.guidance.set_point = None
        self.landed = altitude_m <= 0
        self._flown = not self.landed
        self._armed_s = self.now_s
        self._set_armed(armed or not self.landed)
        self.enter(Mode.HOLD)

    def say(self, text: str) -> None:
        """STATUSTEXT, at most 50 bytes."""
        message = mavlink.MAVLink_statustext_message(mavlink.MAV_SEVERITY_CRITICAL, text.encode()[:50])
        self._out.append(Reply(message))

    def _set_armed(self, armed: bool) -> None:
        if armed != self.armed:
            self.armed = armed
            self._out += [Happened("armed" if armed else "disarmed"), Reply(self.heartbeat())]

    # -- messages that are sent outside the streams too -----------------------------------------------------

    def heartbeat(self) -> mavlink.MAVLink_heartbeat_message:
        base = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        if self.armed:
            base |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        state = mavlink.MAV_STATE_ACTIVE if self.armed else mavlink.MAV_STATE_STANDBY
        kind = int(self.parameters["MAV_TYPE"])
        return mavlink.MAVLink_heartbeat_message(kind, mavlink.MAV_AUTOPILOT_PX4, base, self.mode.custom_mode, state, 3)

    def home_position(self) -> mavlink.MAVLink_home_position_message:
        home, origin = self.guidance.home, self.guidance.origin
        north, east = origin.metres_to(home.latitude_deg, home.longitude_deg)
        return mavlink.MAVLink_home_position_message(
            *(round(home.latitude_deg * 1e7), round(home.longitude_deg * 1e7), round(home.altitude_m * 1000)),
            *(north, east, -self.guidance.home_up_m, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0),
            round(self.now_s * 1e6),
        )
