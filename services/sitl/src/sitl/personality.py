"""The interface behind which kinds of autopilots differ; each kind has a package of its own."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

from pymavlink.dialects.v20 import development as mavlink

from .autopilot import Autopilot
from .dynamics import Energy
from .fleet import DroneConfig
from .logs import LogLink
from .outputs import Output
from .parameters import Parameters
from .plan_link import PlanLink
from .telemetry import Telemetry


class Personality(ABC):
    """One kind of autopilot. It has no state; the objects that it makes for a drone do.

    `title` is its name for people; `release` and `capabilities` are AUTOPILOT_VERSION's. `silent` are messages whose
    interval it accepts, although nothing here makes it send them. For a message that it does not have, `no_interval`,
    `no_interval_told` and `no_message` are the results of setting its interval, of reading it, and of requesting the
    message. `tells_modes_at_once`: it reports a change of mode by an additional heartbeat. `answers_pings`: it answers
    PING. `unsigned` are the messages that it accepts without a signature although it has a key.

    A drone's `autopilot` and `telemetry` are made of these classes, and for each of its links a `plan_link` and a
    `log_link`.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    release: ClassVar[int]
    capabilities: ClassVar[int] = (
        mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
        | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
        | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
        | mavlink.MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
        | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
        | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
        | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
        | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_RALLY
    )
    silent: ClassVar[frozenset[int]] = frozenset()
    no_interval: ClassVar[int]
    no_interval_told: ClassVar[int]
    no_message: ClassVar[int]
    tells_modes_at_once: ClassVar[bool]
    answers_pings: ClassVar[bool]
    unsigned: ClassVar[frozenset[int]]
    autopilot: ClassVar[type[Autopilot]]
    telemetry: ClassVar[type[Telemetry]]
    plan_link: ClassVar[type[PlanLink]]
    log_link: ClassVar[type[LogLink]]

    @abstractmethod
    def rates_hz(self, chosen: str) -> Mapping[str, float]:
        """The rate in Hz of each message that it can send, on a link with the set of streams `chosen`."""

    @abstractmethod
    def parameters(self, config: DroneConfig) -> Parameters:
        """Make a drone's parameters; raises SitlError for one that this kind does not have."""

    @abstractmethod
    def battery(self, parameters: Parameters) -> Energy:
        """Make the battery of its own simulation, for a drone whose battery the fleet does not name."""

    @staticmethod
    @abstractmethod
    def handle(autopilot: Any, message: Any) -> list[Output]:
        """Carry out a command, a mode change or a set-point that is for this system; others have no answer."""
