"""ArduCopter's state: its modes, when it arms, disarms and takes itself for landed."""

from __future__ import annotations

from pymavlink.dialects.v20 import development as mavlink

from ..autopilot import FALL_M_S, IN_AIR, LANDING, ON_GROUND, TAKEOFF, Autopilot, FlightMode
from ..dynamics import Energy, Place, Vector
from ..parameters import Parameters
from ..setpoints import SetPoint
from .guidance import CopterGuidance
from .modes import ARMABLE, UNPOWERED, Mode

SPOOL_UP_S = 0.6
"""From a takeoff's command to the first of its motion."""
STICK_S = 1.2
"""So much later where the stick decides."""
ARMING_S = 2.0
"""After arming the motors wait so long."""


class ArduCopter(Autopilot):
    """An ArduPilot multicopter whose sticks nobody holds: the throttle lies at the bottom."""

    rest = Mode.GUIDED
    unlanded_s = SPOOL_UP_S
    grounded_s = 1.5
    guidance: CopterGuidance

    def __init__(self, system_id: int, home: Place, battery: Energy, parameters: Parameters) -> None:
        super().__init__(system_id, battery, CopterGuidance(home, parameters))
        self._takes_off = False

    @property
    def landed_state(self) -> int:
        if self.landed:
            return ON_GROUND
        if self._is_landing():
            return LANDING
        return TAKEOFF if self._takes_off else IN_AIR

    @property
    def has_target(self) -> bool:
        return self.mode is Mode.GUIDED and not self.landed and self.guidance.set_point is None

    def _is_landing(self) -> bool:
        return self.mode is Mode.LAND or (self.mode is Mode.RTL and self.guidance.lands)

    def _fly(self, dt_s: float) -> None:
        if self._lift_s is None:
            return
        if self._takes_off and self.guidance.is_near(self.guidance.target[2]):
            self._takes_off = False
        if self.mode in UNPOWERED:
            self.motion.fall(FALL_M_S, dt_s)
        elif self.now_s - self._lift_s >= SPOOL_UP_S:
            wanted = self.guidance.wanted_velocity(self.mode, self.now_s)
            self.motion.step(wanted, self.guidance.limits(self.mode), dt_s)

    def _wants_up(self) -> bool:
        return self._takes_off

    def _disarm_when_due(self) -> None:
        """After a landing at once where the mode was for that, else after DISARM_DELAY; 0 turns that off."""
        delay_s = self.parameters["DISARM_DELAY"]
        is_due = 0 < delay_s <= self.now_s - max(self._armed_s, self._landed_s)
        if self._is_landing() or (is_due and self._lift_s is None):
            self.disarm()

    # -- what callers change --------------------------------------------------------------------------------

    def arm_refusal(self) -> str | None:
        """Why arming is denied now, if it is."""
        if self.mode is Mode.AUTO:
            return "Arm: Mode requires mission"
        if self.mode not in ARMABLE:
            return f"Arm: {self.mode.name} mode not armable"
        return None if self.healthy else "Arm: GPS 1: Bad fix"

    def mode_refusal(self, mode: FlightMode) -> str | None:
        """Why a mode cannot be entered now, if it cannot: there is no mission."""
        return "init failed" if mode is Mode.AUTO and self.armed else None

    def arm(self) -> None:
        if not self.armed:
            self.guidance.home = self.guidance.place
            self._armed_s = self.now_s
            self._lift_s = None if self.landed else self.now_s - SPOOL_UP_S
            self.guidance.stop()
            self.say("Arming motors", mavlink.MAV_SEVERITY_INFO)
            self._set_armed(True)

    def disarm(self) -> None:
        """The mode stays."""
        if self.armed:
            self.say("Disarming motors", mavlink.MAV_SEVERITY_INFO)
        self._set_armed(False)
        self._lift_s, self._takes_off = None, False

    def enter(self, mode: FlightMode) -> None:
        if mode is self.mode:
            return
        self._takes_off = False
        if self.landed:
            self._lift_s = None
        self.guidance.stop()
        if mode is Mode.RTL:
            self.guidance.start_return()
        self._change_mode(mode)

    def take_off(self, up_m: float) -> None:
        """In GUIDED, from the ground, to a height over the origin."""
        north, east, _ = self.motion.position
        self.guidance.go((north, east, up_m))
        self._takes_off, self._lift_s = True, max(self.now_s, self._armed_s + ARMING_S)

    def speed_up(self) -> None:
        """On the ground in a mode of the sticks: the motors alone, and for a moment it takes itself for flying."""
        self._lift_s = max(self.now_s + STICK_S, self._armed_s + ARMING_S)

    def go(self, target: Vector) -> None:
        """In GUIDED, to a place; on the ground it stays there."""
        self._takes_off = False
        self.guidance.go(target)

    def follow(self, point: SetPoint) -> None:
        """In GUIDED in the air, a velocity."""
        self._takes_off = False
        self.guidance.set_point = point
