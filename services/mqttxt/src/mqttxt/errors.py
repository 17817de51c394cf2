"""The errors of mqttxt, in one tree.

MqttxtError
├── ConfigurationError     a setting that cannot work; the message names it (exit code 2)
│   └── NotInControl       the station does not control the drone
├── AuditBroken            an audit log that is damaged or was altered
├── PayloadError           a payload or topic that does not follow the specification
│   └── PlanMistakes       a plan file with mistakes, a line for each
├── TransportError         a broker or an autopilot link that refuses or is lost
│   └── BrokerRefused      the broker refused a connection or a subscription for good
├── FogUnreachable         no live activator answered a ground station in time
│   └── SigningDiffers     an activator signs messages and the station does not, or the reverse
├── TransferFailed         a drone did not store, or not deliver, an object such as a plan
├── StationEnded           the ground station that was waited for has ended
├── PartEnded              a process of the demo has ended by itself
└── Refused                another live process already owns this drone's or fog's number
"""

from __future__ import annotations

from collections.abc import Sequence


class MqttxtError(Exception):
    """Base of every error that mqttxt raises on purpose."""

    exit_code = 1

    @property
    def lines(self) -> tuple[str, ...]:
        """The message for people: one line, unless a subclass has several."""
        return (str(self),)


class ConfigurationError(MqttxtError):
    """A setting that cannot work: the message names the setting, its value and what was expected.

    For a file with several mistakes `lines` has one line for each.
    """

    exit_code = 2

    def __init__(self, *lines: str) -> None:
        super().__init__("\n".join(lines))
        self._lines = lines

    @property
    def lines(self) -> tuple[str, ...]:
        return self._lines


class NotInControl(ConfigurationError):
    """The station does not control the drone; `holder` is the name of the station that does, None if there is none."""

    def __init__(self, drone: str, holder: str | None) -> None:
        super().__init__(f"drone {drone}: expected this station in control, not {holder or 'nobody'}")
        self.holder = holder


class AuditBroken(MqttxtError):
    """An audit log that is damaged or was altered; the message names the first line that shows it."""


class PayloadError(MqttxtError):
    """A payload or topic that does not follow the specification; `kind` names the rule it breaks."""

    def __init__(self, message: str, kind: str = "malformed") -> None:
        super().__init__(message)
        self.kind = kind


class PlanMistakes(PayloadError):
    """A plan file with mistakes; `lines` has one line for each, and the message all lines."""

    def __init__(self, lines: Sequence[str]) -> None:
        super().__init__("\n".join(lines))
        self._lines = tuple(lines)

    @property
    def lines(self) -> tuple[str, ...]:
        return self._lines


class TransportError(MqttxtError):
    """A broker or an autopilot link that refuses or is lost."""


class BrokerRefused(TransportError):
    """The broker refused a connection or a subscription for good, or reported that another client took over the id."""


class FogUnreachable(MqttxtError):
    """No live activator answered a ground station in time."""


class SigningDiffers(FogUnreachable):
    """An activator signs messages and the ground station does not, or the reverse."""


class TransferFailed(MqttxtError):
    """A drone did not store, or not deliver, an object such as a plan; the message says why.

    `reason` is the drone's own, as `unknown_hash`; None if it gave none.
    """

    def __init__(self, message: str, reason: str | None = None) -> None:
        super().__init__(message)
        self.reason = reason


class StationEnded(MqttxtError):
    """The ground station has ended, and receives nothing more."""


class PartEnded(MqttxtError):
    """A process of the demo has ended on its own; the message names it, how it ended, and its last output."""


class Refused(MqttxtError):
    """Another live process already owns this drone's or fog's number."""
