"""The commands of MQTT-XT, from a ground station to a drone (docs/protocol.md, section 5)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

from ..errors import PayloadError
from .fields import (
    FLOAT32_MAX,
    U16,
    Finite,
    Hash,
    Integer,
    Items,
    Latitude,
    Longitude,
    Name,
    Real,
    Scaled,
    Text,
    Variant,
)

Height = Annotated[float, Scaled(1000, -500, 10_000)]
"""Metres above home."""


@dataclass(frozen=True)
class Arm:
    """Start the motors. Completed when the autopilot reports itself armed."""

    name: ClassVar[str] = "arm"
    limit_s: ClassVar[float] = 10.0


@dataclass(frozen=True)
class Disarm:
    """Stop the motors, on the ground only: it is never forced."""

    name: ClassVar[str] = "disarm"
    limit_s: ClassVar[float] = 10.0


@dataclass(frozen=True)
class Takeoff:
    """Climb to `altitude_m` metres above home. Completed when airborne at that altitude."""

    name: ClassVar[str] = "takeoff"
    limit_s: ClassVar[float] = 120.0
    altitude_m: Annotated[float, Scaled(1000, 0.5, 10_000)] = 10.0


@dataclass(frozen=True)
class Land:
    """Land where the drone is. Completed when landed and disarmed."""

    name: ClassVar[str] = "land"
    limit_s: ClassVar[float] = 300.0


@dataclass(frozen=True)
class Goto:
    """Fly to a position at `altitude_m` metres above home. Completed on arrival."""

    latitude_deg: Latitude
    longitude_deg: Longitude
    altitude_m: Height
    name: ClassVar[str] = "goto"
    limit_s: ClassVar[float] = 900.0


@dataclass(frozen=True)
class Hold:
    """Stop and stay. Completed when the autopilot is in its hold mode and stands still."""

    name: ClassVar[str] = "hold"
    limit_s: ClassVar[float] = 30.0


@dataclass(frozen=True)
class Return:
    """Return to the take-off point and land there. Completed when landed and disarmed."""

    name: ClassVar[str] = "return"
    limit_s: ClassVar[float] = 900.0


Angle = Annotated[float, Scaled(100, -360, 360)]
"""Degrees clockwise from north."""
Tilt = Annotated[float, Scaled(100, -60, 60)]
"""Degrees; what the autopilot's own limits allow may be less."""
Velocity3 = Annotated[float, Scaled(100, -100, 100)]
"""Metres a second along one axis; the autopilot's own limits are usually nearer."""


@dataclass(frozen=True)
class Velocity:
    """Metres a second north, east and down; the heading in degrees, left as it is without `yaw_deg`."""

    north_m_s: Velocity3
    east_m_s: Velocity3
    down_m_s: Velocity3
    yaw_deg: Angle | None = None


@dataclass(frozen=True)
class Attitude:
    """Roll (right side down), pitch (nose up) and yaw in degrees, and the thrust from 0 to 1."""

    roll_deg: Tilt
    pitch_deg: Tilt
    yaw_deg: Angle
    thrust: Annotated[float, Scaled(1000, 0, 1)]


@dataclass(frozen=True)
class Offboard:
    """Fly by one set-point, streamed on the drone, for `duration_s` seconds; then hold. Completed when it holds.

    Exactly one of `velocity` and `attitude` is given.
    """

    duration_s: Annotated[float, Scaled(10, 0.1, 3600)]
    velocity: Velocity | None = None
    attitude: Attitude | None = None
    name: ClassVar[str] = "offboard"

    def __post_init__(self) -> None:
        """Raises PayloadError for both or neither."""
        if (self.velocity is None) == (self.attitude is None):
            raise PayloadError("offboard: expected either velocity or attitude")

    @property
    def limit_s(self) -> float:
        """duration_s + 30 s"""
        return self.duration_s + 30.0


@dataclass(frozen=True)
class Stream:
    """Publish a state at a fixed rate, or with `mavlink/NAME` any message of common.xml; rate 0 ends that.

    Completed when such a message came. Lasts until then, or until the UAV client starts anew.
    """

    state: Annotated[str, Text(64)]
    rate_hz: Annotated[float, Scaled(100, 0, 50)]
    name: ClassVar[str] = "stream"

    @property
    def limit_s(self) -> float:
        """10 s and two messages"""
        return 10.0 + (2 / self.rate_hz if self.rate_hz else 0.0)


CommandParameter = Annotated[float | None, Real(FLOAT32_MAX)]
"""A parameter of a MAV_CMD; None, or NaN, is MAVLink's "not set"."""


@dataclass(frozen=True)
class Mavlink:
    """A MAV_CMD (`mav_cmd`) with its seven `params`, sent once as COMMAND_LONG. Completed when it is accepted.

    That says nothing of its effect, so that the word is marked `observed` false. `component` is the autopilot
    unless given.
    """

    mav_cmd: U16
    params: Annotated[tuple[CommandParameter, ...], Items(7, least=7)]
    component: Annotated[int, Integer(1, 255)] | None = None
    name: ClassVar[str] = "mavlink"
    limit_s: ClassVar[float] = 60.0

    def __post_init__(self) -> None:
        """Replace NaN by None, so that equal commands compare equal. Raises PayloadError unless there are seven."""
        if len(self.params) != 7:
            raise PayloadError(f"mavlink params: expected 7, got {len(self.params)}")
        params = tuple(None if param is None or math.isnan(param) else param for param in self.params)
        object.__setattr__(self, "params", params)


ItemNumber = Annotated[int, Integer(1, 2**16 - 1)]
"""An item of a mission by its place in the plan, counted from 1 as QGroundControl does."""


@dataclass(frozen=True)
class UploadPlan:
    """Replace the drone's plan by the staged object `plan`. Completed when what was read back is that plan.

    The lists that the object does not have stay (section 16).
    """

    plan: Hash
    name: ClassVar[str] = "upload_plan"
    limit_s: ClassVar[float] = 300.0


@dataclass(frozen=True)
class ClearPlan:
    """Remove the drone's mission, geofence and rally points. Completed when they were read back as empty."""

    name: ClassVar[str] = "clear_plan"
    limit_s: ClassVar[float] = 60.0


@dataclass(frozen=True)
class StartMission:
    """Fly the mission `mission` from an item on. Completed when its last item is behind the drone.

    Behind an item that lands, or returns, the drone has landed by then and is disarmed; else it holds.
    """

    mission: Hash
    item: ItemNumber = 1
    name: ClassVar[str] = "start_mission"
    limit_s: ClassVar[float] = 14_400.0


@dataclass(frozen=True)
class Pause:
    """Stop the mission that is flown, and stay. Completed as `hold` is."""

    name: ClassVar[str] = "pause"
    limit_s: ClassVar[float] = 30.0


@dataclass(frozen=True)
class Resume:
    """Fly the mission `mission` on from its current item. Completed as `start_mission` is."""

    mission: Hash
    name: ClassVar[str] = "resume"
    limit_s: ClassVar[float] = 14_400.0


@dataclass(frozen=True)
class SetCurrentItem:
    """Make an item of the mission `mission` the current one. Completed when the autopilot says that it is."""

    mission: Hash
    item: ItemNumber
    name: ClassVar[str] = "set_current_item"
    limit_s: ClassVar[float] = 10.0


@dataclass(frozen=True)
class SetParameter:
    """Set the parameter `parameter` of the autopilot to `value`. Completed when it was read back as that."""

    parameter: Annotated[str, Name(16)]
    value: Annotated[float, Finite()]
    name: ClassVar[str] = "set_parameter"
    limit_s: ClassVar[float] = 30.0


PlanCommand = UploadPlan | ClearPlan
"""What changes a drone's plan, for which a station needs a right of its own."""

Command = (
    Arm
    | Disarm
    | Takeoff
    | Land
    | Goto
    | Hold
    | Return
    | Offboard
    | Stream
    | Mavlink
    | UploadPlan
    | ClearPlan
    | StartMission
    | Pause
    | Resume
    | SetCurrentItem
    | SetParameter
)

COMMANDS: dict[str, type[Command]] = {
    c.name: c
    for c in (
        Arm, Disarm, Takeoff, Land, Goto, Hold, Return, Offboard, Stream, Mavlink,
        UploadPlan, ClearPlan, StartMission, Pause, Resume, SetCurrentItem, SetParameter,
    )
}  # fmt: skip
"""Every command by its name, in the order of their codes."""

BROADCASTABLE = (Arm, Disarm, Takeoff, Land, Hold, Return, Stream, Pause)
"""What `fogX/commands` takes: the same for every drone of a fog."""

COMMAND = Variant("command", tuple((code, cls.name, cls) for code, cls in enumerate(COMMANDS.values(), start=1)))


def haversine_m(latitude_1: float, longitude_1: float, latitude_2: float, longitude_2: float) -> float:
    """Great-circle distance in metres between two positions in degrees, on a sphere of R = 6,371,000 m.

    It is defined for any finite numbers: rounding at antipodes and latitudes beyond a pole are clipped.
    """
    phi_1, phi_2 = math.radians(latitude_1), math.radians(latitude_2)
    half_phi = (phi_2 - phi_1) / 2
    half_lambda = math.radians(longitude_2 - longitude_1) / 2
    a = math.sin(half_phi) ** 2 + math.cos(phi_1) * math.cos(phi_2) * math.sin(half_lambda) ** 2
    return 2 * 6_371_000 * math.asin(math.sqrt(min(1.0, max(0.0, a))))
