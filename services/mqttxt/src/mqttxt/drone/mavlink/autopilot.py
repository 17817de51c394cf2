"""What differs between kinds of autopilots, behind one interface; each kind has a module of its own."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

from pymavlink.dialects.v20 import common as mavlink

from ...protocol.commands import Command
from ...protocol.parameters import ParameterSet
from ...protocol.plans import PlanItem
from ...protocol.states import FlightModeName, Health
from .plans import Effect, Group, Plan

if TYPE_CHECKING:
    from .vehicle import Vehicle


class Autopilot(ABC):
    """One kind of autopilot: what its messages mean, and how commands are written to it. It keeps nothing.

    `types` are the HEARTBEAT.type of those that fly so, None where modes and commands are the same for all.
    `max_speed` and `cruise_speed` are the parameters that have the largest horizontal speed and the cruise speed,
    any one of each, and what makes their values metres a second. `hold_mode` is the mode in which it stays where it
    is, `offboard_mode` the one in which it follows set-points; `is_offboard_alone`: it does nothing else there.
    `priming` set-points have to come before that mode. `refuses_as_failed`: it says MAV_RESULT_FAILED of what it does
    not begin. `explains_afterwards`: its reason comes behind its refusal. `answers_twice` are the MAV_CMDs that it
    may accept first, and then say what became of them. `home_items`: how many items its mission has in front of a
    plan's own. `tells_of_fence`: it sends FENCE_STATUS, where it is asked to. `ends_on_nan`: a NaN among a command's
    parameters ends its process. `bytewise`: whole parameters are carried as their bytes, else as numbers.
    """

    name: ClassVar[str]
    max_speed: ClassVar[Mapping[str, float]]
    cruise_speed: ClassVar[Mapping[str, float]]
    types: ClassVar[frozenset[int] | None] = None
    hold_mode: ClassVar[FlightModeName]
    offboard_mode: ClassVar[FlightModeName]
    is_offboard_alone: ClassVar[bool]
    priming: ClassVar[int]
    refuses_as_failed: ClassVar[bool]
    explains_afterwards: ClassVar[bool] = False
    answers_twice: ClassVar[frozenset[int]] = frozenset()
    home_items: ClassVar[int] = 0
    tells_of_fence: ClassVar[bool] = False
    ends_on_nan: ClassVar[bool] = False
    bytewise: ClassVar[bool]

    @abstractmethod
    def flight_mode(self, heartbeat: Any) -> FlightModeName:
        """The mode in a HEARTBEAT; UNKNOWN for one that has no name here."""

    @abstractmethod
    def health(self, status: Any) -> Health:
        """The state in a SYS_STATUS."""

    @abstractmethod
    def set_mode(self, vehicle: Vehicle, name: FlightModeName) -> Any:
        """MAV_CMD_DO_SET_MODE as COMMAND_LONG; raises KeyError for a mode that this kind does not have."""

    @abstractmethod
    def kept(self, item: PlanItem) -> PlanItem:
        """What it keeps of an item of a plan; of what it gives back, the same."""

    def hash_check(self, parameters: ParameterSet) -> int | None:
        """The number that it gives as _HASH_CHECK where it has these parameters; None where it has no such number."""
        return None

    @abstractmethod
    def has_ended(self, vehicle: Vehicle, after: int) -> bool:
        """Whether messages after number `after` show that it has left a mission whose last item was reached."""

    @abstractmethod
    def plan(self, command: Command, vehicle: Vehicle, now_ms: int) -> Plan:
        """The plan of a command; raises CannotExecute where the autopilot's state does not allow to say it.

        `stream` and `mavlink` are the same for all kinds, and have their plans elsewhere.
        """

    def _mode(self, vehicle: Vehicle, name: FlightModeName, effect: Effect) -> Plan:
        """The plan of a command that is a mode."""
        message = self.set_mode(vehicle, name)
        return Plan(message, mavlink.MAV_CMD_DO_SET_MODE, Group.MOTION, effect, frozenset({name}))
