"""The autopilot's state: armed or not, in which mode, on the ground or flying; no I/O, time moves by `step`."""

from __future__ import annotations

from pymavlink.dialects.v20 import development as mavlink

from .dynamics import Energy, Motion, Place
from .guidance import FALL_M_S, GROUNDED_S, Guidance
from .modes import NEEDS_STICKS, Happened, Mode, Output, Reply
from .parameters import Parameters

STEP_S = 0.02
LOW_BATTERY_PCT = 7.0
"""COM_ARM_BAT_MIN is off in PX4; below its emergency level (BAT_EMERGEN_THR, 5 %, and some) nobody should start."""
UNLANDED_S = 1.0
"""So long after the motors speed up the land detector takes the drone for flying."""
_ON_GROUND, _IN_AIR = int(mavlink.MAV_LANDED_STATE_ON_GROUND), int(mavlink.MAV_LANDED_STATE_IN_AIR)
_TAKEOFF, _LANDING = int(mavlink.MAV_LANDED_STATE_TAKEOFF), int(mavlink.MAV_LANDED_STATE_LANDING)


class Autopilot:
    """One multicopter. What changes by itself comes out of `step`, what a caller changes out of `take_out`."""

    def __init__(self, system_id: int, home: Place, battery: Energy, parameters: Parameters) -> None:
        self.system_id = system_id
        self.parameters = parameters
        self.battery = battery
        self.guidance = Guidance(home, parameters)
        self.mode = Mode.HOLD
        self.armed = False
        self.healthy = True
        self.landed = True
        self.failsafe = False
        self.now_s = 0.0
        self._armed_s = 0.0
        self._landed_s = 0.0
        self._touched_s: float | None = None
        self._lift_s: float | None = None
        """When the motors began to speed up for a flight; None on the ground without one."""
        self._flown = False
        self._takes_off = False
        """Whether this takeoff began on the ground."""
        self._out: list[Output] = []

    @property
    def motion(self) -> Motion:
        return self.guidance.motion

    @property
    def landed_state(self) -> int:
        """MAV_LANDED_STATE."""
        if self.landed:
            return _ON_GROUND
        if self.mode is Mode.LAND or (self.mode is Mode.RETURN and self.guidance.lands):
            return _LANDING
        return _TAKEOFF if self._takes_off else _IN_AIR

    def step(self, dt_s: float = STEP_S) -> list[Output]:
        """Fly on for `dt_s`."""
        self.now_s += dt_s
        if self.armed:
            self._begin_flight()
            self._end_modes()
            if self._lift_s is not None:
                lift_s = self.now_s - self._lift_s
                wanted = self.guidance.wanted_velocity(self.mode, self.now_s, lift_s, not self._takes_off)
                self.motion.step(wanted, self.guidance.limits, dt_s)
        elif not self.landed:
            self.motion.fall(FALL_M_S, dt_s)
        self._notice_ground()
        self.battery.step(self.motion, self.armed, self.armed and not self.landed, dt_s)
        self._disarm_when_due()
        return self.take_out()

    def take_out(self) -> list[Output]:
        """What followed from the calls since the last time, in order."""
        out, self._out = self._out, []
        return out

    def _begin_flight(self) -> None:
        """On the ground the motors speed up COM_SPOOLUP_TIME after arming, for whatever leads upwards."""
        if self._lift_s is not None or not self.landed or not self._wants_up():
            return
        if self.now_s - self._armed_s >= self.parameters["COM_SPOOLUP_TIME"]:
            self._lift_s = self.now_s

    def _wants_up(self) -> bool:
        if self.mode is Mode.TAKEOFF or (self.mode is Mode.HOLD and self.guidance.target[2] > 1.0):
            return self.guidance.target[2] > self.motion.position[2]
        point = self.guidance.set_point
        if self.mode is not Mode.OFFBOARD or point is None:
            return False
        return (point.velocity or (0.0, 0.0, 0.0))[2] > 0 or (point.position or (0.0, 0.0, 0.0))[2] > 0

    def _end_modes(self) -> None:
        """A takeoff ends in hold at its height, an offboard flight whose controller is silent in a return."""
        if self.mode is Mode.TAKEOFF and self._lift_s is not None and self.guidance.takeoff_done(self.now_s):
            target = self.guidance.target
            self.enter(Mode.HOLD)
            self.guidance.target = target
        elif self.mode is Mode.OFFBOARD and not self.guidance.has_set_point(self.now_s):
            self.say("Failsafe activated: no offboard signal")
            self.enter(Mode.RETURN)
            self.failsafe = True

    def _notice_ground(self) -> None:
        on_ground = self.motion.position[2] <= 0.0 and self.motion.velocity[2] <= 0.0
        if self.landed:
            if self._lift_s is not None and self.now_s - self._lift_s >= UNLANDED_S:
                self.landed, self._flown, self._touched_s = False, True, None
                self._out.append(Happened("took_off"))
            return
        rises = self.armed and self._lift_s is not None and self._wants_up()
        if not on_ground or rises:
            self._touched_s = None
        elif self._touched_s is None:
            self._touched_s = self.now_s
        elif self.now_s - self._touched_s >= GROUNDED_S:
            self.landed, self._landed_s, self._lift_s = True, self.now_s, None
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
        if self.mode in (Mode.LAND, Mode.RETURN) or not self.can_fly_in(self.mode):
            return "Arming denied: mode not armable"
        return None

    def can_fly_in(self, mode: Mode) -> bool:
        """Whether what a mode needs is there: no sticks ever, no mission, perhaps a stream of set-points."""
        if mode in NEEDS_STICKS or mode is Mode.MISSION:
            return False
        return mode is not Mode.OFFBOARD or self.guidance.has_set_point(self.now_s)

    def arm(self) -> None:
        """Home is where the drone is armed."""
        if not self.armed:
            self.guidance.home = self.guidance.place
            self._armed_s, self._flown = self.now_s, not self.landed
            self._lift_s = None if self.landed else self.now_s - self.parameters["MPC_TKO_RAMP_T"] * 2
            if self.mode is not Mode.TAKEOFF:
                self.guidance.stop_here()
            self._set_armed(True)

    def disarm(self) -> None:
        """A mode that has nothing left to do gives way to hold."""
        self._set_armed(False)
        self._lift_s = None
        self.failsafe = False
        if self.mode in (Mode.LAND, Mode.RETURN) and self.landed:
            self.enter(Mode.HOLD)

    def enter(self, mode: Mode) -> None:
        """Change the mode, as a pilot can at any time; hold aims at where the drone can stop."""
        if mode is Mode.HOLD and self.mode is not Mode.HOLD:
            self.guidance.hold(self.mode)
        self.failsafe = False
        if mode is not self.mode:
            self._takes_off = mode is Mode.TAKEOFF and self.landed
            self.guidance.start(mode, self.now_s)
            self.mode = mode
            self._out.append(Happened("mode", {"mode": mode.name.lower()}))

    def put_back(self, *, altitude_m: float, armed: bool) -> None:
        """Into a starting state for an experiment: at home, in hold, on the ground or hovering (then always armed)."""
        self.guidance.motion = Motion(position=[0.0, 0.0, altitude_m])
        self.guidance.home = self.guidance.origin
        self.guidance.set_point = None
        self.landed = altitude_m <= 0
        self._flown = not self.landed
        self._armed_s = self.now_s
        self._touched_s = None
        self._lift_s = None if self.landed else self.now_s - 60.0
        self._set_armed(armed or not self.landed)
        self.enter(Mode.HOLD)
        self.guidance.target = (0.0, 0.0, altitude_m)

    def say(self, text: str) -> None:
        """STATUSTEXT, at most 50 bytes."""
        message = mavlink.MAVLink_statustext_message(mavlink.MAV_SEVERITY_CRITICAL, text.encode()[:50])
        self._out.append(Reply(message))

    def _set_armed(self, armed: bool) -> None:
        if armed != self.armed:
            self.armed = armed
            self._out.append(Happened("armed" if armed else "disarmed"))
