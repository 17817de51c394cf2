"""MQTT-XT: drones as ordinary nodes of an IoT network, over MQTT 5.

The ground station's API is re-exported here. `station`, `activator` and `drone` are the nodes, on `core` and
`protocol`; `cli` has them as commands. A name is imported when it is first asked for, so that a command, or a program
that needs one role, does not load the others.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .errors import (
        BrokerRefused,
        ConfigurationError,
        FogUnreachable,
        MqttxtError,
        PayloadError,
        Refused,
        StationEnded,
        TransportError,
    )
    from .protocol.commands import (
        Arm,
        Attitude,
        Command,
        Disarm,
        Goto,
        Hold,
        Land,
        Mavlink,
        Offboard,
        Return,
        Stream,
        Takeoff,
        Velocity,
    )
    from .protocol.messages import CommandId, Word
    from .protocol.rankings import Candidate, Ranked
    from .protocol.states import (
        STATES,
        Armed,
        Battery,
        Endurance,
        FlightMode,
        FlightModeName,
        Groundspeed,
        Heading,
        Health,
        Home,
        Landed,
        LandedState,
        Location,
        MavlinkState,
        MaxGroundspeed,
        State,
    )
    from .protocol.values import Encoding
    from .station.ground_station import GroundStation
    from .station.heard import EventStream, SentCommand
    from .station.outcomes import (
        ControlChanged,
        Event,
        Outcome,
        Outcomes,
        PsmiList,
        QodsRanking,
        Reachability,
        SensorReading,
        StateUpdate,
    )
    from .station.views import Drone, Fog, KnownState

__version__ = "0.1.0"

__all__ = [
    "STATES",
    "Arm",
    "Armed",
    "Attitude",
    "Battery",
    "BrokerRefused",
    "Candidate",
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
    "FlightMode",
    "FlightModeName",
    "Fog",
    "FogUnreachable",
    "Goto",
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
    "Location",
    "Mavlink",
    "MavlinkState",
    "MaxGroundspeed",
    "MqttxtError",
    "Offboard",
    "Outcome",
    "Outcomes",
    "PayloadError",
    "PsmiList",
    "QodsRanking",
    "Ranked",
    "Reachability",
    "Refused",
    "Return",
    "SensorReading",
    "SentCommand",
    "State",
    "StateUpdate",
    "StationEnded",
    "Stream",
    "Takeoff",
    "TransportError",
    "Velocity",
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
    "station.views",
    "station.ground_station",
)
"""Where the public names are, in the order in which one imports the next."""


def __getattr__(name: str) -> Any:
    for home in _HOMES if name in __all__ else ():
        module = import_module(f".{home}", __name__)
        if hasattr(module, name):
            globals()[name] = getattr(module, name)
            return globals()[name]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
