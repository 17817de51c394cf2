"""MQTT-XT: drones as ordinary nodes of an IoT network, over MQTT 5.

The ground station's API is re-exported here; `mqttxt.cli` has the roles as commands. The pure modules
(`topics`, `clock`, `commands`, `states`, `messages`, `wire`, `dialect`, `roles`) know no network; `io` does.
"""

from .commands import (
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
from .gs import Drone, Fog, GroundStation, KnownState
from .messages import CommandId, Word
from .outcomes import ControlChanged, Event, Outcome, PsmiList, QodsRanking, Reachability, SensorReading, StateUpdate
from .rankings import Candidate, Ranked
from .states import (
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
from .wire.values import Encoding

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
    "PayloadError",
    "PsmiList",
    "QodsRanking",
    "Ranked",
    "Reachability",
    "Refused",
    "Return",
    "SensorReading",
    "State",
    "StateUpdate",
    "StationEnded",
    "Stream",
    "Takeoff",
    "TransportError",
    "Velocity",
    "Word",
]
