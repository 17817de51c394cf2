"""The errors of mqttxt, in one tree.

MqttxtError
├── ConfigurationError     a setting that cannot work; the message names it (exit code 2)
├── PayloadError           a payload or topic that does not follow the specification
├── TransportError         a broker or an autopilot link that refuses or is lost
│   └── BrokerRefused      the broker answered CONNECT with a reason code that retrying cannot mend
├── FogUnreachable         no live activator answered a ground station in time
├── StationEnded           the ground station that was waited for has ended
└── Refused                another live process already owns this drone's or fog's number
"""

from __future__ import annotations


class MqttxtError(Exception):
    """Base of every error that mqttxt raises on purpose."""

    exit_code = 1


class ConfigurationError(MqttxtError):
    """A setting that cannot work: the message names the setting, its value and what was expected."""

    exit_code = 2


class PayloadError(MqttxtError):
    """A payload or topic that does not follow the specification; `kind` names the rule it breaks."""

    def __init__(self, message: str, kind: str = "malformed") -> None:
        super().__init__(message)
        self.kind = kind


class TransportError(MqttxtError):
    """A broker or an autopilot link that refuses or is lost."""


class BrokerRefused(TransportError):
    """The broker answered CONNECT with a reason code that retrying cannot mend."""


class FogUnreachable(MqttxtError):
    """No live activator answered a ground station in time."""


class StationEnded(MqttxtError):
    """The ground station has ended, and nothing more is heard by it."""


class Refused(MqttxtError):
    """Another live process already owns this drone's or fog's number."""
