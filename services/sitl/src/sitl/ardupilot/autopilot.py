"""ArduCopter's state: its modes, and when it arms, disarms and detects a landing."""

from __future__ import annotations

from pymavlink.dialects.v20 import development as mavlink

from ..autopilot import FALL_M_S, Autopilot, FlightMode
from ..dynamics import Energy, Place, Vector
from ..mission import Leg
from ..parameters import Parameters
from ..setpoints import SetPoint
from .guidance import CopterGuidance
from .modes import ARMABLE, UNPOWERED, Mode

SPOOL_UP_S = 0.6
"""The time from a takeoff command to its first motion."""
AUTO_S = 0.5
"""The additional time of a mission's takeoff."""
CLIMBED_M = 0.1
"""A mission's takeoff is over when the drone is nearer than this to its height."""
STICK_S = 1.2
"""The additional time in a mode of the sticks."""
ARMING_S = 2.0
"""How long the motors wait after arming."""


class ArduCopter(Autopilot):
    """An ArduPilot multicopter without a pilot at its sticks: the throttle is at the bottom."""

    guided_by = CopterGuidance
    rest = Mode.GUIDED
    unlanded_s = SPOOL_UP_S
    grounded_s = 1.5
    guidance: CopterGuidance

    def __init__(self, system_id: int, home: Place, battery: Energy, parameters: Parameters) -> None:
        super().__init__(system_id, home, battery, parameters)
        self.mission.first = 1
        self._flies_mission = False
        """Whether the mission was begun: on the ground AUTO alone does not begin it."""

    @property
    def flies_as(self) -> Mode:
        """The mode as which it flies: a mission lands and returns as the modes for that do."""
        mode = self.mode
        assert isinstance(mode, Mode)
        if mode is not Mode.AUTO:
            return mode
        if self.mission.leg is Leg.LAND and not self.guidance.is_above(self.mission.target):
            return Mode.AUTO
        return _LEGS.get(self.mission.leg, Mode.AUTO)

    @property
    def has_target(self) -> bool:
        return self.mode is Mode.GUIDED and not self.landed and self.guidance.set_point is None

    def _is_landing(self) -> bool:
        return self.flies_as is Mode.LAND or (self.flies_as is Mode.RTL and self.guidance.lands)

    def _fly(self, dt_s: float) -> None:
        if self._flies_mission:
            self._fly_mission()
        if self._lift_s is None:
            return
        if self._takes_off and self.guidance.is_near(self.guidance.target[2]):
            self._takes_off = False
        if self.mode in UNPOWERED:
            self.motion.fall(FALL_M_S, dt_s)
        elif self.now_s - self._lift_s >= SPOOL_UP_S:
            wanted = self.guidance.wanted_velocity(self.flies_as, self.now_s)
            self.motion.step(wanted, self.guidance.limits(self.flies_as), dt_s)

    def _fly_mission(self) -> None:
        """Fly item after item; after the last one stay in AUTO, in place."""
        leg, target = self.mission.leg, self.mission.target
        is_there = self.guidance.is_there(target, self.mission.waits)
        if leg is Leg.TAKEOFF:
            is_there = target[2] - self.motion.position[2] < CLIMBED_M
        self._out += self.mission.step(self.now_s, is_there)
        if self.mission.leg is not leg or self.mission.target != target:
            self._lead()

    def _lead(self) -> None:
        """Begin the mission's current leg."""
        self.guidance.cruise_m_s = self.mission.speed_m_s
        leg, target = self.mission.leg, self.mission.target
        if leg is Leg.RETURN:
            self.guidance.start_return()
        elif leg is Leg.TAKEOFF and self.landed:
            self.take_off(target[2])
            self._lift_s = (self._lift_s or self.now_s) + AUTO_S
        elif leg is Leg.LAND:
            self.guidance.go((*target[:2], self.motion.position[2]))
        elif leg in (Leg.GO, Leg.STAY):
            self.guidance.go(target)
        else:
            self.guidance.stop()

    def start_mission(self) -> None:
        """Begin or continue the mission in AUTO."""
        self._flies_mission = True
        self._out += self.mission.begin()
        self._lead()

    def _wants_up(self) -> bool:
        return self._takes_off

    def _disarm_when_due(self) -> None:
        """Disarm at once after the landing of a mode that lands, else after DISARM_DELAY; 0 turns that off."""
        delay_s = self.parameters["DISARM_DELAY"]
        is_due = 0 < delay_s <= self.now_s - max(self._armed_s, self._landed_s)
        if self._is_landing() or (is_due and self._lift_s is None):
            self.disarm()

    # -- changes by callers ---------------------------------------------------------------------------------

    def arm_refusal(self) -> str | None:
        """The reason why arming is denied now, or None."""
        if self.mode is Mode.AUTO and not self.plans.mission:
            return "Arm: Mode requires mission"
        if self.mode not in ARMABLE:
            return f"Arm: {self.mode.name} mode not armable"
        return None if self.healthy else "Arm: GPS 1: Bad fix"

    def mode_refusal(self, mode: FlightMode) -> str | None:
        """The reason why a mode cannot be entered now, or None: armed, AUTO needs a mission."""
        return "init failed" if mode is Mode.AUTO and self.armed and not self.plans.mission else None

    def arm(self) -> None:
        if not self.armed:
            self.guidance.home = self.guidance.place
            self._armed_s = self.now_s
            self._lift_s = None if self.landed else self.now_s - SPOOL_UP_S
            self.guidance.stop()
            self.say("Arming motors", mavlink.MAV_SEVERITY_INFO)
            self._set_armed(True)

    def disarm(self) -> None:
        """Stop the motors; the mode stays."""
        if self.armed:
            self.say("Disarming motors", mavlink.MAV_SEVERITY_INFO)
        self._set_armed(False)
        if self._flies_mission and self.mission.leg in (Leg.LAND, Leg.RETURN) and self.landed:
            self._out += self.mission.arrive()
        self._lift_s, self._takes_off, self._flies_mission = None, False, False
        self.plans.go_to(0)

    def enter(self, mode: FlightMode) -> None:
        if mode is self.mode:
            return
        self._takes_off = False
        if self.landed:
            self._lift_s = None
        self.guidance.stop()
        if mode is Mode.RTL:
            self.guidance.start_return()
        self._flies_mission, self.guidance.cruise_m_s = False, None
        self._change_mode(mode)
        if mode is Mode.AUTO and not self.landed:
            self.start_mission()

    def take_off(self, up_m: float) -> None:
        """Take off in GUIDED, from the ground, to a height above the origin."""
        north, east, _ = self.motion.position
        self.guidance.go((north, east, up_m))
        self._takes_off, self._lift_s = True, max(self.now_s, self._armed_s + ARMING_S)

    def speed_up(self) -> None:
        """Speed up the motors on the ground in a mode of the sticks; for a moment the land detector reports flight."""
        self._lift_s = max(self.now_s + STICK_S, self._armed_s + ARMING_S)

    def go(self, target: Vector) -> None:
        """Fly to a place in GUIDED; on the ground the drone does not move."""
        self._takes_off = False
        self.guidance.go(target)

    def follow(self, point: SetPoint) -> None:
        """Follow a velocity, in GUIDED in the air."""
        self._takes_off = False
        self.guidance.set_point = point


_LEGS = {Leg.LAND: Mode.LAND, Leg.RETURN: Mode.RTL}
