"""One simulated vehicle: the autopilot with its parameters, telemetry and links; no I/O.

Everything but flight is answered here: parameters, requested messages, intervals, pings, the file protocol.
"""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from .autopilot import STEP_S, Autopilot, Mode, Output, Reply
from .dynamics import Battery
from .errors import SitlError
from .fleet import DroneConfig
from .parameters import Parameters
from .streams import NAMES, Streams
from .telemetry import Telemetry

_FTP_NAK, _FTP_FILE_NOT_FOUND = 129, 10
_CAPABILITIES = (
    mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
    | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
)


class Vehicle:
    """A vehicle and the streams of its links, by link number."""

    def __init__(self, config: DroneConfig, stream_sets: list[str], seed: int = 1) -> None:
        self.config = config
        parameters = Parameters({**config.parameters, "MAV_SYS_ID": config.system_id})
        battery = Battery(config.capacity_wh, config.capacity_wh * config.charge_pct / 100)
        self.autopilot = Autopilot(config.system_id, config.home, battery, parameters)
        self.telemetry = Telemetry(self.autopilot, seed * 1000 + config.system_id)
        self.links = [Streams(chosen) for chosen in stream_sets]
        self.muted: set[str] = set()

    def advance(self, now_s: float) -> list[Output]:
        """Fly up to `now_s` in fixed steps, so that the same inputs at the same times give the same flight."""
        out: list[Output] = []
        while self.autopilot.now_s + STEP_S <= now_s + 1e-9:
            out += self.autopilot.step()
        return self._unmuted(out)

    def streamed(self, link: int, now_s: float) -> list[Any]:
        """The messages that are due on a link."""
        names = self.links[link].due(now_s)
        return [self.telemetry.make(name) for name in names if name not in self.muted]

    def handle(self, link: int, message: Any) -> list[Output]:
        """Answer a message that came in on a link; one for another system has no answer."""
        if not self._is_for_us(message):
            return []
        kind = message.get_type()
        if kind in ("PARAM_REQUEST_LIST", "PARAM_REQUEST_READ", "PARAM_SET"):
            return [Reply(answer) for answer in self.autopilot.parameters.on_message(message)]
        if kind == "PING" and message.target_system == 0:
            source = (message.get_srcSystem(), message.get_srcComponent())
            return [Reply(mavlink.MAVLink_ping_message(message.time_usec, message.seq, *source))]
        if kind == "TIMESYNC" and message.tc1 == 0:
            now_ns = round(self.autopilot.now_s * 1e9)
            return [Reply(mavlink.MAVLink_timesync_message(now_ns, message.ts1))]
        if kind == "FILE_TRANSFER_PROTOCOL":
            return [Reply(_ftp_nak(message))]
        if kind == "COMMAND_LONG" and message.command in _REQUESTS:
            return self._unmuted(self._request(link, message))
        return self._unmuted(self.autopilot.handle(message))

    def control(self, request: dict[str, Any]) -> tuple[dict[str, Any], list[Output]]:
        """The side channel: `{"set": {...}}` or `{"get": "state"}`; raises SitlError for anything else."""
        out: list[Output] = []
        if set(request) == {"set"} and isinstance(request["set"], dict):
            out = self._set(request["set"])
        elif request != {"get": "state"}:
            raise SitlError(f"{request}: expected {{'get': 'state'}} or {{'set': {{…}}}}")
        return self._state(), self._unmuted(out)

    def _set(self, wanted: dict[str, Any]) -> list[Output]:
        unknown = set(wanted) - {"mode", "armed", "altitude_m", "battery_pct", "healthy", "mute"}
        if unknown:
            raise SitlError(
                f"set {', '.join(sorted(unknown))}: expected mode, armed, altitude_m, battery_pct, healthy or mute"
            )
        out: list[Output] = []
        try:
            mode = Mode[str(wanted["mode"]).upper()] if "mode" in wanted else None
            battery_pct = float(wanted.get("battery_pct", self.autopilot.battery.remaining_pct))
            altitude_m = float(wanted.get("altitude_m", 0.0))
            self.muted = {str(name) for name in wanted.get("mute", self.muted)}
        except (KeyError, TypeError, ValueError) as error:
            raise SitlError(f"set {wanted}: {error!r}; expected a mode's name, numbers, and a list of names") from error
        if "armed" in wanted or "altitude_m" in wanted:
            out += self.autopilot.put_back(altitude_m=altitude_m, armed=bool(wanted.get("armed", False)))
        if mode is not None:
            out += self.autopilot.pilot(mode)
        self.autopilot.battery.left_wh = self.autopilot.battery.capacity_wh * battery_pct / 100
        self.autopilot.healthy = bool(wanted.get("healthy", self.autopilot.healthy))
        return out

    def _state(self) -> dict[str, Any]:
        place = self.autopilot.place
        return {
            "mode": self.autopilot.mode.name.lower(),
            "armed": self.autopilot.armed,
            "landed": self.autopilot.landed,
            "latitude_deg": round(place.latitude_deg, 7),
            "longitude_deg": round(place.longitude_deg, 7),
            "altitude_m": round(self.autopilot.motion.position[2] - self.autopilot.home_up_m, 3),
            "groundspeed_m_s": round(self.autopilot.motion.groundspeed_m_s, 3),
            "battery_pct": round(self.autopilot.battery.remaining_pct, 2),
        }

    def _is_for_us(self, message: Any) -> bool:
        system = getattr(message, "target_system", 0)
        component = getattr(message, "target_component", 0)
        return system in (0, self.config.system_id) and component in (0, 1)

    def _request(self, link: int, message: Any) -> list[Output]:
        """Requests for messages and intervals: acknowledged, then answered."""
        result = int(mavlink.MAV_RESULT_ACCEPTED)
        answers: list[Any] = []
        wanted = int(message.param1)
        if message.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            if not self.links[link].set_interval(wanted, message.param2):
                result = int(mavlink.MAV_RESULT_UNSUPPORTED)
        elif message.command == mavlink.MAV_CMD_GET_MESSAGE_INTERVAL:
            interval = self.links[link].interval_us(wanted)
            answers.append(mavlink.MAVLink_message_interval_message(wanted, interval))
        elif message.command == mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES or wanted == _VERSION:
            answers.append(self._version())
        elif wanted in NAMES:
            answers.append(self.telemetry.make(NAMES[wanted]))
        else:
            result = int(mavlink.MAV_RESULT_UNSUPPORTED)
        source = (message.get_srcSystem(), message.get_srcComponent())
        ack = mavlink.MAVLink_command_ack_message(message.command, result, 0, 0, *source)
        return [Reply(ack), *(Reply(answer) for answer in answers)]

    def _version(self) -> Any:
        release = 1 << 24 | 15 << 16 | 4 << 8 | 255
        return mavlink.MAVLink_autopilot_version_message(
            *(_CAPABILITIES, release, release, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, self.config.system_id)
        )

    def _unmuted(self, out: list[Output]) -> list[Output]:
        return [o for o in out if not (isinstance(o, Reply) and o.message.get_type() in self.muted)]


_VERSION = mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION
_REQUESTS = frozenset(
    {
        mavlink.MAV_CMD_SET_MESSAGE_INTERVAL,
        mavlink.MAV_CMD_GET_MESSAGE_INTERVAL,
        mavlink.MAV_CMD_REQUEST_MESSAGE,
        mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES,
    }
)


def _ftp_nak(message: Any) -> Any:
    """MAVProxy asks for parameters by file first, and waits 12 s where nothing says that there is none."""
    request = bytes(message.payload)
    sequence = (int.from_bytes(request[0:2], "little") + 1) & 0xFFFF
    header = sequence.to_bytes(2, "little") + bytes([request[2], _FTP_NAK, 1, request[3], 0, 0, 0, 0, 0, 0])
    payload = (header + bytes([_FTP_FILE_NOT_FOUND])).ljust(251, b"\0")
    source = (message.get_srcSystem(), message.get_srcComponent())
    return mavlink.MAVLink_file_transfer_protocol_message(0, *source, list(payload))
