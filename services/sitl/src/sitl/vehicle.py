"""One simulated vehicle: the autopilot with its parameters, telemetry and links; no I/O.

Everything but flight is answered here: parameters, plans, logs, requested messages, intervals, pings, and the file
protocol (which has no files).
"""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import development as mavlink

from . import control
from .answers import ACCEPTED, DENIED, UNSUPPORTED, acknowledgement, received, whole
from .autopilot import STEP_S
from .dynamics import Battery, Energy
from .fleet import DroneConfig
from .logs import MESSAGES as LOG_MESSAGES
from .outputs import Happened, Output, Reply
from .parameters import Parameters
from .personality import Personality
from .plan_link import MESSAGES as PLAN_MESSAGES
from .progress import Progress
from .px4.personality import PX4
from .streams import Streams

_FTP_NAK, _FTP_FILE_NOT_FOUND = 129, 10


class Vehicle:
    """A vehicle and the streams of its links, by link number."""

    def __init__(self, config: DroneConfig, stream_sets: list[str], seed: int = 1, like: Personality = PX4) -> None:
        self.config = config
        self.like = like
        parameters = like.parameters(config)
        battery = _battery(config, like, parameters)
        self.autopilot = like.autopilot(config.system_id, config.home, battery, parameters)
        self.telemetry = like.telemetry(self.autopilot, seed * 1000 + config.system_id, quiet=config.quiet)
        self.links = [Streams(like.rates_hz(chosen), like.silent) for chosen in stream_sets]
        self._plan_links = [like.plan_link(self.autopilot) for _ in stream_sets]
        self._log_links = [like.log_link(self.autopilot) for _ in stream_sets]
        self.muted: set[str] = set()
        self.progress = Progress()

    def advance(self, now_s: float) -> list[Output]:
        """Fly up to `now_s` in fixed steps, so that the same inputs at the same times give the same flight."""
        out: list[Output] = []
        while self.autopilot.now_s + STEP_S <= now_s + 1e-9:
            out += self.autopilot.step()
            steps, finished = self.progress.due(self.autopilot.now_s)
            out += steps
            if finished is not None:
                out += self.like.handle(self.autopilot, finished.message)
        return self._unmuted(out)

    def streamed(self, link: int, now_s: float) -> list[Any]:
        """The messages that are due on a link."""
        names = self.links[link].due(now_s)
        made = [self.telemetry.make(name) for name in names if name not in self.muted]
        said = [*self._plan_links[link].due(now_s), *self._log_links[link].due()]
        asked = [message for message in said if message.get_type() not in self.muted]
        return [*asked, *(message for message in made if message is not None)]

    def handle(self, link: int, message: Any) -> list[Output]:
        """Answer a message that arrived on a link; one for another system has no answer."""
        return self._unmuted(self._answer(link, message)) if self.is_for_us(message) else []

    def _answer(self, link: int, message: Any) -> list[Output]:
        kind = message.get_type()
        if kind in ("PARAM_REQUEST_LIST", "PARAM_REQUEST_READ", "PARAM_SET"):
            return [Reply(answer) for answer in self.autopilot.parameters.on_message(message)]
        if kind == "PING":
            if not self.like.answers_pings or message.target_system != 0:
                return []
            return [Reply(mavlink.MAVLink_ping_message(message.time_usec, message.seq, *_source(message)))]
        if kind == "TIMESYNC" and message.tc1 == 0:
            now_ns = round(self.autopilot.now_s * 1e9)
            return [Reply(mavlink.MAVLink_timesync_message(now_ns, message.ts1))]
        if kind == "FILE_TRANSFER_PROTOCOL":
            return [Reply(_ftp_nak(message))]
        if kind in PLAN_MESSAGES:
            answers = self._plan_links[link].answer(message, self.autopilot.now_s)
            return [*map(Reply, answers), *self.autopilot.take_out()]
        if kind in LOG_MESSAGES:
            self._log_links[link].answer(message)
            return [*self.autopilot.take_out()]
        is_command = kind in ("COMMAND_LONG", "COMMAND_INT")
        steps = self.progress.take(message, self.autopilot.now_s) if is_command else None
        if steps is not None:
            return steps
        if is_command and message.command in _REQUESTS:
            return [received(message), *self._request(link, message)]
        return self.like.handle(self.autopilot, message)

    def control(self, request: Any) -> tuple[dict[str, Any], list[Output]]:
        """Carry out a request of the side channel and return the state after it. Raises SitlError for a wrong one."""
        wanted = control.parse(request, type(self.autopilot.rest))
        if wanted is not None:
            self.muted = set(wanted.get("mute", self.muted))
            if "in_progress" in wanted:
                self.progress.set(wanted["in_progress"])
            control.apply(self.autopilot, wanted)
        return control.state(self.autopilot), self._unmuted(self.autopilot.take_out())

    def position(self) -> Happened:
        """Where the drone is, for the events file."""
        return Happened("position", control.state(self.autopilot))

    def is_for_us(self, message: Any) -> bool:
        """Whether a message is addressed to this autopilot, or to all."""
        system = getattr(message, "target_system", 0)
        component = getattr(message, "target_component", 0)
        return system in (0, self.config.system_id) and component in (0, 1)

    def _request(self, link: int, message: Any) -> list[Output]:
        """Acknowledge a request for a message or an interval, then answer it."""
        wanted = whole(message.param1)
        result, answers = ACCEPTED, []
        if message.command == mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES:
            answers.append(self._version())
        elif wanted is None:
            result = DENIED
        elif message.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            if not self.links[link].set_interval(wanted, message.param2):
                result = self.like.no_interval
        elif message.command == mavlink.MAV_CMD_GET_MESSAGE_INTERVAL:
            if 0 <= wanted <= 0xFFFF:
                interval_us = self.links[link].interval_us(wanted)
                answers.append(mavlink.MAVLink_message_interval_message(wanted, interval_us))
                if interval_us == 0:
                    result = self.like.no_interval_told
            else:
                result = UNSUPPORTED
        elif wanted == mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION:
            answers.append(self._version())
        elif (name := self.links[link].name(wanted)) and (answer := self.telemetry.make(name)) is not None:
            answers.append(answer)
        else:
            result = self.like.no_message
        return [Reply(acknowledgement(message, result)), *(Reply(answer) for answer in answers)]

    def _version(self) -> Any:
        release = self.like.release
        return mavlink.MAVLink_autopilot_version_message(
            capabilities=self.like.capabilities,
            flight_sw_version=release,
            middleware_sw_version=release,
            os_sw_version=0,
            board_version=0,
            flight_custom_version=[0] * 8,
            middleware_custom_version=[0] * 8,
            os_custom_version=[0] * 8,
            vendor_id=0,
            product_id=0,
            uid=self.config.system_id,
        )

    def _unmuted(self, out: list[Output]) -> list[Output]:
        """Leave out muted messages; add a heartbeat after a change of mode if the kind reports that at once."""
        changes = [o for o in out if isinstance(o, Happened) and o.event == "mode"]
        if changes and self.like.tells_modes_at_once:
            out = [*out, Reply(self.telemetry.make("HEARTBEAT"))]
        return [o for o in out if not (isinstance(o, Reply) and o.message.get_type() in self.muted)]


_REQUESTS = frozenset(
    {
        mavlink.MAV_CMD_SET_MESSAGE_INTERVAL,
        mavlink.MAV_CMD_GET_MESSAGE_INTERVAL,
        mavlink.MAV_CMD_REQUEST_MESSAGE,
        mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES,
    }
)


def _battery(config: DroneConfig, like: Personality, parameters: Parameters) -> Energy:
    """A battery of the fleet's capacity, so that rankings differ; else that of the kind's own simulation."""
    if config.capacity_wh is not None:
        return Battery(config.capacity_wh, config.capacity_wh * config.charge_pct / 100)
    return like.battery(parameters)


def _source(message: Any) -> tuple[int, int]:
    return message.get_srcSystem(), message.get_srcComponent()


def _ftp_nak(message: Any) -> Any:
    """Answer "file not found": MAVProxy first requests parameters as a file, and waits 12 s without an answer."""
    request = bytes(message.payload)
    sequence = (int.from_bytes(request[0:2], "little") + 1) & 0xFFFF
    header = sequence.to_bytes(2, "little") + bytes([request[2], _FTP_NAK, 1, request[3], 0, 0, 0, 0, 0, 0])
    payload = (header + bytes([_FTP_FILE_NOT_FOUND])).ljust(251, b"\0")
    return mavlink.MAVLink_file_transfer_protocol_message(0, *_source(message), list(payload))
