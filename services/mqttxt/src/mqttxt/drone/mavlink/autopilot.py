"""The interface to the differences between kinds of autopilots; each kind has a module of its own."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar

from pymavlink.dialects.v20 import common as mavlink

from ...protocol.commands import (
    Arm,
    Command,
    Disarm,
    Goto,
    Hold,
    Land,
    Offboard,
    Pause,
    Resume,
    Return,
    StartMission,
    Takeoff,
)
from ...protocol.parameters import ParameterSet
from ...protocol.plans import PlanItem
from ...protocol.states import Armed, FlightMode, FlightModeName, Health
from .plans import (
    NAN,
    CommandPlan,
    Effect,
    Group,
    arming,
    check_pause,
    command_long,
    is_down,
    mission,
    never,
    reposition,
)

if TYPE_CHECKING:
    from .vehicle import Vehicle


class Autopilot(ABC):
    """One kind of autopilot: the meaning of its messages, and the form of commands to it. It has no state.

    `types` are the HEARTBEAT.type values that it is for, None if modes and commands are the same for all.
    `max_speed` and `cruise_speed` name the parameters for the largest horizontal speed and the cruise speed, any one
    of each, with the factors that convert their values to m/s. `hold_mode` is the mode in which it stays where it
    is, `offboard_mode` the one in which it follows set-points; `is_offboard_alone`: that mode has no other use.
    `ready_mode` is the one in which it is armed on the ground and flies to positions, which are in `goto_frame`;
    `stays_armed_in` are all modes in which a drone that is armed on the ground stays there.
    `priming` is how many set-points have to precede that mode. `refuses_as_failed`: it refuses commands with
    MAV_RESULT_FAILED. `explains_afterwards`: its reason follows its refusal. `answers_twice` are the MAV_CMDs that it
    may first accept, and then acknowledge again with the result. `home_items`: how many items its mission has before
    those of the plan. `tells_of_fence`: it sends FENCE_STATUS on request. `ends_on_nan`: a NaN among a command's
    parameters ends its process. `bytewise`: integer parameters are carried as their bytes, otherwise as numbers.
    """

    name: ClassVar[str]
    max_speed: ClassVar[Mapping[str, float]]
    cruise_speed: ClassVar[Mapping[str, float]]
    types: ClassVar[frozenset[int] | None] = None
    hold_mode: ClassVar[FlightModeName]
    offboard_mode: ClassVar[FlightModeName]
    ready_mode: ClassVar[FlightModeName]
    stays_armed_in: ClassVar[frozenset[FlightModeName]]
    goto_frame: ClassVar[int]
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
        """The mode in a HEARTBEAT; UNKNOWN for one without a FlightModeName."""

    @abstractmethod
    def health(self, status: Any) -> Health:
        """The state in a SYS_STATUS."""

    @abstractmethod
    def set_mode(self, vehicle: Vehicle, name: FlightModeName) -> Any:
        """MAV_CMD_DO_SET_MODE as COMMAND_LONG. Raises KeyError for a mode that this kind does not have."""

    @abstractmethod
    def kept(self, item: PlanItem) -> PlanItem:
        """An item with only the fields that the autopilot keeps, to compare it with one read back."""

    def hash_check(self, parameters: ParameterSet) -> int | None:
        """The _HASH_CHECK that an autopilot with these parameters reports; None if this kind has none."""
        return None

    @abstractmethod
    def has_ended(self, vehicle: Vehicle, after: int) -> bool:
        """Whether messages after number `after` show that it has ended a mission whose last item was reached."""

    def plan(self, command: Command, vehicle: Vehicle, now_ms: int) -> CommandPlan:
        """The plan of a command. Raises CannotExecute if the autopilot's state forbids it.

        `stream` and `mavlink` are the same for all kinds, and are planned elsewhere.
        """
        unset = 0.0 if self.ends_on_nan else NAN
        if isinstance(command, Arm):
            mode, is_armed = vehicle.seen(FlightMode), vehicle.seen(Armed) == Armed(True)
            stays = is_armed or (mode is not None and mode.mode in self.stays_armed_in)
            return replace(arming(command, vehicle), first_mode=None if stays else self.ready_mode)
        if isinstance(command, Disarm):
            return arming(command, vehicle)
        if isinstance(command, Takeoff):
            return self._takeoff(command, vehicle, now_ms)
        if isinstance(command, Goto):
            return reposition(command, vehicle, self.goto_frame, unset, self.ready_mode)
        if isinstance(command, Land):
            land = mavlink.MAV_CMD_NAV_LAND
            message = command_long(vehicle, land, *[unset] * 7)
            return self._landing(CommandPlan(message, land, Group.MOTION, is_down, frozenset({FlightModeName.LAND})))
        if isinstance(command, Pause):
            check_pause(vehicle)
        if isinstance(command, Hold | Pause):
            return self._hold(vehicle, now_ms)
        if isinstance(command, StartMission | Resume):
            return mission(vehicle, self._mission(vehicle))
        if isinstance(command, Offboard):
            return self._mode(vehicle, self.offboard_mode, never)
        assert isinstance(command, Return)
        return self._landing(self._mode(vehicle, FlightModeName.RETURN, is_down))

    @abstractmethod
    def _takeoff(self, command: Takeoff, vehicle: Vehicle, now_ms: int) -> CommandPlan: ...

    @abstractmethod
    def _hold(self, vehicle: Vehicle, now_ms: int) -> CommandPlan: ...

    @abstractmethod
    def _mission(self, vehicle: Vehicle) -> CommandPlan:
        """The start of the mission, at its current item."""

    def _landing(self, plan: CommandPlan) -> CommandPlan:
        """A plan that ends on the ground, with what this kind does there."""
        return plan

    def _mode(self, vehicle: Vehicle, name: FlightModeName, effect: Effect) -> CommandPlan:
        """The plan of a command that is a mode."""
        message = self.set_mode(vehicle, name)
        return CommandPlan(message, mavlink.MAV_CMD_DO_SET_MODE, Group.MOTION, effect, frozenset({name}))
