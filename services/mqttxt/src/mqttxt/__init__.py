"""MQTT-XT: drones as ordinary nodes of an IoT network, over MQTT 5.

The ground station's API is re-exported here. `station`, `activator` and `drone` are the nodes, built on `core` and
`protocol`; `cli` has them as commands. A name is imported on first access, so that a command, or a program that needs
one role, does not load the others.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .errors import (
        BrokerRefused,
        ConfigurationError,
        FogUnreachable,
        MqttxtError,
        NotInControl,
        PayloadError,
        Refused,
        StationEnded,
        TransferFailed,
        TransportError,
    )
    from .protocol.commands import (
        Arm,
        Attitude,
        ClearPlan,
        Command,
        Disarm,
        Goto,
        Hold,
        Land,
        Mavlink,
        Offboard,
        Pause,
        Resume,
        Return,
        SetCurrentItem,
        SetParameter,
        StartMission,
        Stream,
        Takeoff,
        UploadPlan,
        Velocity,
    )
    from .protocol.logs import FlightLog
    from .protocol.messages import CommandId, Word
    from .protocol.parameters import Parameter, ParameterType
    from .protocol.rankings import Candidate, Ranked
    from .protocol.states import (
        STATES,
        Airframe,
        Armed,
        AutopilotText,
        Battery,
        Endurance,
        Fence,
        FlightMode,
        FlightModeName,
        Gps,
        GpsFix,
        Groundspeed,
        Heading,
        Health,
        Home,
        Landed,
        LandedState,
        Location,
        MavlinkState,
        MaxGroundspeed,
        Mission,
        Power,
        Severity,
        State,
        VelocityNed,
    )
    from .protocol.values import Encoding
    from .station.fleets import Fleets
    from .station.ground_station import GroundStation
    from .station.heard import EventStream, SentCommand
    from .station.log_download import LogProgress
    from .station.outcomes import (
        ControlChanged,
        Event,
        ListBehind,
        Outcome,
        Outcomes,
        PsmiList,
        QodsRanking,
        Reachability,
        SensorReading,
        StateUpdate,
    )
    from .station.parameters import ParameterDifference, Parameters
    from .station.plan import Plan
    from .station.views import Drone, Fog, KnownState

__version__ = "0.1.0"

__all__ = [
    "STATES",
    "Airframe",
    "Arm",
    "Armed",
    "Attitude",
    "AutopilotText",
    "Battery",
    "BrokerRefused",
    "Candidate",
    "ClearPlan",
    "Command",
    "CommandId",
    "ConfigurationError",
    "ControlChanged",
    "Disarm",
    "Drone",
    "Encoding",
    "Endurance",
    "Event",
    "EventStream",
    "Fence",
    "Fleets",
    "FlightLog",
    "FlightMode",
    "FlightModeName",
    "Fog",
    "FogUnreachable",
    "Goto",
    "Gps",
    "GpsFix",
    "GroundStation",
    "Groundspeed",
    "Heading",
    "Health",
    "Hold",
    "Home",
    "KnownState",
    "Land",
    "Landed",
    "LandedState",
    "ListBehind",
    "Location",
    "LogProgress",
    "Mavlink",
    "MavlinkState",
    "MaxGroundspeed",
    "Mission",
    "MqttxtError",
    "NotInControl",
    "Offboard",
    "Outcome",
    "Outcomes",
    "Parameter",
    "ParameterDifference",
    "ParameterType",
    "Parameters",
    "Pause",
    "PayloadError",
    "Plan",
    "Power",
    "PsmiList",
    "QodsRanking",
    "Ranked",
    "Reachability",
    "Refused",
    "Resume",
    "Return",
    "SensorReading",
    "SentCommand",
    "SetCurrentItem",
    "SetParameter",
    "Severity",
    "StartMission",
    "State",
    "StateUpdate",
    "StationEnded",
    "Stream",
    "Takeoff",
    "TransferFailed",
    "TransportError",
    "UploadPlan",
    "Velocity",
    "VelocityNed",
    "Word",
]

_HOMES = (
    "errors",
    "protocol.values",
    "protocol.commands",
    "protocol.messages",
    "protocol.rankings",
    "protocol.states",
    "station.outcomes",
    "station.heard",
    "protocol.parameters",
    "protocol.logs",
    "station.parameters",
    "station.plan",
    "station.log_download",
    "station.views",
    "station.ground_station",
    "station.fleets",
)
"""The modules of the public names; later ones import earlier ones."""


def __getattr__(name: str) -> Any:
    for home in _HOMES if name in __all__ else ():
        module = import_module(f".{home}", __name__)
        if hasattr(module, name):
            globals()[name] = getattr(module, name)
            return globals()[name]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
