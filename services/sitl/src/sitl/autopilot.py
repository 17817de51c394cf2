"""The state that all kinds of autopilot share: armed, mode, on the ground or in flight. No I/O; `step` moves time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from enum import Enum
from typing import ClassVar

from pymavlink.dialects.v20 import development as mavlink

from .dynamics import Energy, Motion, Place
from .guidance import Guidance
from .logs import Logs
from .mission import MissionFlight
from .outputs import Happened, Output, Reply
from .parameters import Parameters
from .plans import Plans

STEP_S = 0.02
TEXT_BYTES = 50
"""Of the text in one STATUSTEXT."""
FALL_M_S = -10.0
"""Terminal speed of the fall after the motors were stopped in the air."""
ON_GROUND, IN_AIR = int(mavlink.MAV_LANDED_STATE_ON_GROUND), int(mavlink.MAV_LANDED_STATE_IN_AIR)
TAKEOFF, LANDING = int(mavlink.MAV_LANDED_STATE_TAKEOFF), int(mavlink.MAV_LANDED_STATE_LANDING)


class FlightMode(Enum):
    """The flight modes of one kind of autopilot."""

    @property
    def custom_mode(self) -> int:
        """The mode's number in HEARTBEAT."""
        raise NotImplementedError


class Autopilot(ABC):
    """One multicopter. `step` returns the outputs of passing time, `take_out` those of a caller's changes.

    `rest` is the mode in which it waits for commands. The land detector reports flight `unlanded_s` after the motors
    speed up, and a landing after `grounded_s` on the ground.
    """

    guided_by: ClassVar[type[Guidance]]
    rest: ClassVar[FlightMode]
    unlanded_s: ClassVar[float]
    grounded_s: ClassVar[float]

    def __init__(self, system_id: int, home: Place, battery: Energy, parameters: Parameters) -> None:
        self.system_id = system_id
        self.parameters = parameters
        self.battery = battery
        self.guidance = self.guided_by(home, parameters)
        self.plans = Plans()
        self.logs = Logs()
        self.mission = MissionFlight(self.plans, self.guidance)
        self.mode = self.rest
        self.armed = False
        self.healthy = True
        self.landed = True
        self.failsafe = False
        self.now_s = 0.0
        self._armed_s = 0.0
        self._landed_s = 0.0
        self._touched_s: float | None = None
        self._lift_s: float | None = None
        """When the motors began to speed up for a flight, s; None on the ground before one."""
        self._flown = False
        self._takes_off = False
        """Whether it climbs from the ground to the height of a takeoff."""
        self._out: list[Output] = []
        self._text_id = 0

    @property
    def motion(self) -> Motion:
        return self.guidance.motion

    @property
    def landed_state(self) -> int:
        """MAV_LANDED_STATE."""
        if self.landed:
            return ON_GROUND
        if self._is_landing():
            return LANDING
        return TAKEOFF if self._takes_off else IN_AIR

    @property
    @abstractmethod
    def has_target(self) -> bool:
        """Whether it flies to a place, and reports that as POSITION_TARGET_GLOBAL_INT."""

    def step(self, dt_s: float = STEP_S) -> list[Output]:
        """Fly for `dt_s`, and return the outputs."""
        self.now_s += dt_s
        if self.armed:
            self._fly(dt_s)
        elif not self.landed:
            self.motion.fall(FALL_M_S, dt_s)
        self._notice_ground()
        self.battery.step(self.motion, self.armed, self.armed and not self.landed, dt_s)
        if self.armed and self.landed:
            self._disarm_when_due()
        return self.take_out()

    def take_out(self) -> list[Output]:
        """Return and clear the outputs of the calls since the last time, in order."""
        out, self._out = self._out, []
        return out

    @abstractmethod
    def _fly(self, dt_s: float) -> None:
        """Fly one step of the mode; called while armed."""

    @abstractmethod
    def _wants_up(self) -> bool:
        """Whether the mode, or its target, leads upwards from the ground."""

    @abstractmethod
    def _is_landing(self) -> bool:
        """Whether it descends to land."""

    @abstractmethod
    def _disarm_when_due(self) -> None:
        """Disarm if it is time; called while armed on the ground."""

    def _notice_ground(self) -> None:
        on_ground = self.motion.position[2] <= 0.0 and self.motion.velocity[2] <= 0.0
        if self.landed:
            if self._lift_s is not None and self.now_s - self._lift_s >= self.unlanded_s:
                self.landed, self._flown, self._touched_s = False, True, None
                self._out.append(Happened("took_off"))
            return
        rises = self.armed and self._lift_s is not None and self._wants_up()
        if not on_ground or rises:
            self._touched_s = None
        elif self._touched_s is None:
            self._touched_s = self.now_s
        elif self.now_s - self._touched_s >= self.grounded_s:
            self.landed, self._landed_s, self._lift_s = True, self.now_s, None
            self._out.append(Happened("landed"))

    # -- changes by callers ---------------------------------------------------------------------------------

    @abstractmethod
    def arm(self) -> None:
        """Start the motors, and set home to the present place."""

    @abstractmethod
    def disarm(self) -> None:
        """Stop the motors."""

    @abstractmethod
    def enter(self, mode: FlightMode) -> None:
        """Change the mode, as a pilot can at any time."""

    def put_back(self, *, altitude_m: float, armed: bool) -> None:
        """Put it into an experiment's starting state: home, at rest, on the ground or hovering (then always armed)."""
        self.guidance.motion = Motion(position=[0.0, 0.0, altitude_m])
        self.guidance.home = self.guidance.origin
        self.guidance.set_point = None
        self.landed = altitude_m <= 0
        self._flown = not self.landed
        self._armed_s = self.now_s
        self._touched_s = None
        self._lift_s = None if self.landed else self.now_s - 60.0
        self._set_armed(armed or not self.landed)
        self.enter(self.rest)
        self.guidance.target = (0.0, 0.0, altitude_m)

    def say(self, text: str, severity: int = mavlink.MAV_SEVERITY_CRITICAL) -> None:
        """Send a text in as many STATUSTEXTs as it needs; they share an id if it needs more than one."""
        said = text.encode()
        self._text_id = self._text_id % 0xFFFF + 1
        text_id = self._text_id if len(said) >= TEXT_BYTES else 0
        for number, start in enumerate(range(0, len(said) + bool(text_id), TEXT_BYTES)):
            part = said[start : start + TEXT_BYTES]
            self._out.append(Reply(mavlink.MAVLink_statustext_message(severity, part, text_id, number)))

    def _set_armed(self, armed: bool) -> None:
        if armed != self.armed:
            self.armed = armed
            self._out.append(Happened("armed" if armed else "disarmed"))

    def _change_mode(self, mode: FlightMode) -> None:
        self.mode = mode
        self._out.append(Happened("mode", {"mode": mode.name.lower()}))
