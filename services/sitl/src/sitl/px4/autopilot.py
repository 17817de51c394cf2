"""PX4's state: its modes and what ends them, and when it arms, disarms and detects a landing."""

from __future__ import annotations

from pymavlink.dialects.v20 import common as mavlink

from ..autopilot import Autopilot, FlightMode
from ..dynamics import Energy, Place, Vector
from ..mission import Leg
from ..parameters import Parameters
from .guidance import GROUNDED_S, Px4Guidance
from .modes import NEEDS_STICKS, Mode

SHARE = 0.95
"""The share of the cruise speed at which a mission is flown."""
LOW_BATTERY_PCT = 7.0
"""It does not arm below this. COM_ARM_BAT_MIN is off in PX4; this is its emergency level (BAT_EMERGEN_THR, 5 %) and
some."""


class Px4(Autopilot):
    """A PX4 multicopter."""

    guided_by = Px4Guidance
    rest = Mode.HOLD
    unlanded_s = 1.0
    grounded_s = GROUNDED_S
    guidance: Px4Guidance

    def __init__(self, system_id: int, home: Place, battery: Energy, parameters: Parameters) -> None:
        super().__init__(system_id, home, battery, parameters)
        self._led_to: Vector | None = None
        """The mission's target to which it flies."""

    @property
    def flies_as(self) -> FlightMode:
        """The mode as which it flies: a mission takes off, flies to places and lands as the modes for that do."""
        if self.mode is not Mode.MISSION:
            return self.mode
        if self.mission.leg is Leg.LAND and not self.guidance.is_above(self.mission.target):
            return Mode.HOLD
        return _LEGS.get(self.mission.leg, Mode.HOLD)

    @property
    def has_target(self) -> bool:
        """In the automatic modes only."""
        return self.armed and self.mode.custom_mode >> 16 & 0xFF == 4

    def _is_landing(self) -> bool:
        return self.flies_as is Mode.LAND or (self.mode is Mode.RETURN and self.guidance.lands)

    def _fly(self, dt_s: float) -> None:
        if self.mode is Mode.MISSION:
            self._fly_mission()
        self._begin_flight()
        self._end_modes()
        if self._lift_s is not None:
            lift_s = self.now_s - self._lift_s
            wanted = self.guidance.wanted_velocity(self.flies_as, self.now_s, lift_s, not self._takes_off)
            self.motion.step(wanted, self.guidance.limits, dt_s)

    def _fly_mission(self) -> None:
        """Fly item after item; after the last one hold, or return if that is the last item.

        A takeoff climbs in place, and then flies to the item's place.
        A landing's item is reached above its place; once landed, the drone disarms and stays in its mode.
        """
        leg = self.mission.leg
        if leg is Leg.TAKEOFF and self.guidance.is_high(self.mission.target):
            self.mission.leg = Leg.GO
        self._out += self.mission.step(self.now_s, self.guidance.is_there(self.mission.target))
        if self.mission.leg is Leg.LAND and self.guidance.is_above(self.mission.target):
            arrived = self.mission.arrive()
            if arrived:
                self.guidance.wait(self.now_s)
            self._out += arrived
            if self.landed:
                self.disarm()
        self._lead(leg)

    def _lead(self, leg: Leg) -> None:
        """Begin the mission's current leg if it differs from `leg`, the one before."""
        if self.mission.leg is Leg.RETURN:
            self._out += self.mission.arrive()
            self.enter(Mode.RETURN)
            return
        if self.mission.leg is Leg.OVER:
            self.enter(Mode.HOLD)
            return
        if self.mission.leg is not leg or self._led_to != self.mission.target:
            self._led_to = self.mission.target
            north, east, up = self.mission.target
            lands = self.mission.leg is Leg.LAND
            self.guidance.target = (north, east, self.motion.position[2] if lands else up)
            self.guidance.cruise_m_s = SHARE * (self.mission.speed_m_s or self.parameters["MPC_XY_CRUISE"])
            self.guidance.start(self.flies_as, self.now_s)
            self._takes_off = self.landed

    def _begin_flight(self) -> None:
        """Speed up the motors on the ground, COM_SPOOLUP_TIME after arming, if the mode leads upwards."""
        if self._lift_s is not None or not self.landed or not self._wants_up():
            return
        if self.now_s - self._armed_s >= self.parameters["COM_SPOOLUP_TIME"]:
            self._lift_s = self.now_s

    def _wants_up(self) -> bool:
        mode = self.flies_as
        if mode is Mode.TAKEOFF or (mode is Mode.HOLD and self.guidance.target[2] > 1.0):
            return self.guidance.target[2] > self.motion.position[2]
        point = self.guidance.set_point
        if self.mode is not Mode.OFFBOARD or point is None:
            return False
        return (point.velocity or (0.0, 0.0, 0.0))[2] > 0 or (point.position or (0.0, 0.0, 0.0))[2] > 0

    def _end_modes(self) -> None:
        """End a takeoff in hold at its height, and an offboard flight whose controller is silent in a return."""
        if self.mode is Mode.TAKEOFF and self._lift_s is not None and self.guidance.takeoff_done(self.now_s):
            target = self.guidance.target
            self.enter(Mode.HOLD)
            self.guidance.target = target
        elif self.mode is Mode.OFFBOARD and not self.guidance.has_set_point(self.now_s):
            self.say("Failsafe activated: no offboard signal")
            self.enter(Mode.RETURN)
            self.failsafe = True

    def _disarm_when_due(self) -> None:
        """Disarm COM_DISARM_LAND after a landing, or COM_DISARM_PRFLT after arming; 0 or less turns either off."""
        name, since_s = ("COM_DISARM_LAND", self._landed_s) if self._flown else ("COM_DISARM_PRFLT", self._armed_s)
        after_s = self.parameters[name]
        if 0 < after_s <= self.now_s - since_s:
            self.disarm()

    # -- changes by callers ---------------------------------------------------------------------------------

    def arm_refusal(self) -> str | None:
        """PX4's one text for whatever is against arming now, or None."""
        is_ready = self.healthy and self.battery.remaining_pct >= LOW_BATTERY_PCT
        is_armable = self.mode not in (Mode.LAND, Mode.RETURN) and self.can_fly_in(self.mode)
        return None if is_ready and is_armable else "Arming denied: Resolve system health failures first"

    def say(self, text: str, severity: int = mavlink.MAV_SEVERITY_CRITICAL) -> None:
        """Send a text; the tab at its end marks what PX4 also sends as an event."""
        super().say(f"{text}\t", severity)

    def can_fly_in(self, mode: FlightMode) -> bool:
        """Whether a mode's needs are met: a mission, or a stream of set-points; sticks never are."""
        if mode in NEEDS_STICKS or (mode is Mode.MISSION and not self.plans.mission):
            return False
        return mode is not Mode.OFFBOARD or self.guidance.has_set_point(self.now_s)

    def arm(self) -> None:
        if not self.armed:
            self.guidance.home = self.guidance.place
            self._armed_s, self._flown = self.now_s, not self.landed
            self._lift_s = None if self.landed else self.now_s - self.parameters["MPC_TKO_RAMP_T"] * 2
            if self.mode is not Mode.TAKEOFF:
                self.guidance.stop_here()
            self._set_armed(True)

    def disarm(self) -> None:
        """Stop the motors; after a landing, land and return give way to hold."""
        self._set_armed(False)
        self._lift_s = None
        self.failsafe = False
        if self.mode in (Mode.LAND, Mode.RETURN) and self.landed:
            self.enter(Mode.HOLD)

    def enter(self, mode: FlightMode) -> None:
        """Change the mode; hold aims at the place where the drone can stop."""
        if mode is Mode.HOLD and self.mode is not Mode.HOLD:
            self.guidance.hold(self.mode)
        self.failsafe = False
        if mode is not self.mode:
            self._takes_off = mode is Mode.TAKEOFF and self.landed
            self.guidance.start(mode, self.now_s)
            self._change_mode(mode)
        self.guidance.cruise_m_s = self._led_to = None
        if mode is Mode.MISSION and self.plans.mission:
            self._out += self.mission.begin()
            self._lead(Leg.OVER)


_LEGS: dict[Leg, FlightMode] = {Leg.TAKEOFF: Mode.TAKEOFF, Leg.LAND: Mode.LAND}
