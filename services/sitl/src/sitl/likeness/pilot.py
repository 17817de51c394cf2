"""Flies a case: sends commands, waits for what follows, and writes down what it hears."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import development as mavlink

from ..streams import number
from .channel import Channel, Heard
from .manners import Manners
from .recording import Case

ANSWER_S = 1.5
"""An autopilot that has not answered by then does not answer."""
SECOND_ANSWER_S = 0.1
"""PX4 answers some commands twice."""
HEARTBEAT_S = 1.0
ASKS_S = 1.0
"""How often is asked for messages that do not come."""
PATIENCE = 5.0
"""So many times slower than the wall's clock an autopilot's may be."""
_CLOCKS = ("ATTITUDE", "ATTITUDE_QUATERNION", "GLOBAL_POSITION_INT", "LOCAL_POSITION_NED")
LANDED = {0: "undefined", 1: "on_ground", 2: "in_air", 3: "takeoff", 4: "landing"}
RESULTS = {n: entry.name.removeprefix("MAV_RESULT_").lower() for n, entry in mavlink.enums["MAV_RESULT"].items()}
RESULTS[9] = "command_unsupported_mav_frame"
CURRENT = 0x7FFFFFFF
NAN = math.nan


class Timeout(Exception):
    """What a case waited for did not come: the case cannot be recorded."""


class Pilot:
    """One link to an autopilot, what was last heard on it, and the facts of the case that is flown."""

    def __init__(self, channel: Channel, manners: Manners, system: int) -> None:
        self._channel = channel
        self.manners = manners
        self._system = system
        self._heartbeat_due_s = -math.inf
        self._asks_due_s = -math.inf
        self._results: list[str] = []
        self._asked = -1
        self.last: dict[str, Any] = {}
        self.case = Case()
        self._boot_s: float | None = None
        self._began_s = self._commanded_s = self._clock_s
        self._origin: tuple[float, float, float] | None = None
        self._known: dict[str, str] = {}
        self._track_due_s = math.inf
        self._taps: list[Callable[[Heard], None]] = []
        self.repeat: Callable[[], None] | None = None
        """Called ten times a second while it listens: a stream of set-points."""
        self._repeat_due_s = -math.inf

    # -- what is known ------------------------------------------------------------------------------------------

    @property
    def now_s(self) -> float:
        """Seconds since the case began."""
        return self._clock_s - self._began_s

    @property
    def _clock_s(self) -> float:
        """The autopilot's own clock, for a simulation on a busy machine is slower than the wall's."""
        return self._channel.now_s if self._boot_s is None else self._boot_s

    @property
    def armed(self) -> bool:
        return self._known.get("armed") == "true"

    @property
    def mode(self) -> str:
        return self._known.get("mode", "")

    @property
    def landed(self) -> bool:
        return self._known.get("landed_state") == "on_ground"

    @property
    def ready(self) -> bool:
        """Whether it says that it could arm now."""
        status = self.last.get("SYS_STATUS")
        healthy = 0 if status is None else status.onboard_control_sensors_health
        return bool(healthy & mavlink.MAV_SYS_STATUS_PREARM_CHECK) and "HOME_POSITION" in self.last

    @property
    def position(self) -> tuple[float, float, float]:
        """North, east, up in metres of where the case began."""
        at = self.last["LOCAL_POSITION_NED"]
        origin = self._origin or (0.0, 0.0, 0.0)
        return at.x - origin[0], at.y - origin[1], -at.z - origin[2]

    @property
    def speed_m_s(self) -> float:
        at = self.last["LOCAL_POSITION_NED"]
        return math.sqrt(at.vx**2 + at.vy**2 + at.vz**2)

    # -- the case -----------------------------------------------------------------------------------------------

    def begin(self, *, everything: bool = True) -> None:
        """Start a new case, here and now."""
        self._channel.attend(everything)
        self._known = {}
        self._origin = None
        self._track_due_s = math.inf
        self.until("", lambda: {"armed", "mode", "landed_state"} <= self._known.keys() and bool(self._place()), 20)
        self._origin = self._place()
        self._began_s = self._commanded_s = self._clock_s
        self.case = Case()

    def _place(self) -> tuple[float, float, float] | None:
        at = self.last.get("LOCAL_POSITION_NED")
        return None if at is None else (at.x, at.y, -at.z)

    def track(self) -> None:
        """From now on write down the position once a second."""
        self._track_due_s = self._clock_s

    def until(self, name: str, condition: Callable[[], bool], limit_s: float) -> None:
        """Wait for a condition; its duration counts from the last command. Raises Timeout."""
        end_s, given_up_s = self._clock_s + limit_s, self._channel.now_s + PATIENCE * limit_s
        while not condition():
            if self._clock_s >= end_s or self._channel.now_s >= given_up_s:
                raise Timeout(f"{name}: not within {limit_s:g} s: {self._known} {self.case.acks}")
            self._listen(0.02)
        if name:
            self.case.durations_s[name] = round(self._clock_s - self._commanded_s, 2)

    def mark(self) -> None:
        """Durations count from now on."""
        self._commanded_s = self._clock_s

    def wait(self, seconds: float) -> None:
        end_s, given_up_s = self._clock_s + seconds, self._channel.now_s + PATIENCE * seconds
        while (left_s := end_s - self._clock_s) > 1e-6 and self._channel.now_s < given_up_s:
            self._listen(min(0.1, left_s))

    def collect(self, seconds: float) -> list[Heard]:
        """Everything that comes meanwhile."""
        heard: list[Heard] = []
        tap = heard.append
        self.tap(tap)
        self.wait(seconds)
        self.untap(tap)
        return heard

    def tap(self, take: Callable[[Heard], None]) -> None:
        """Give it everything that is heard from now on."""
        self._taps.append(take)

    def untap(self, take: Callable[[Heard], None]) -> None:
        self._taps.remove(take)

    def count_streams(self, heard: list[Heard]) -> None:
        """Rates and sizes by kind, of what was collected, in the autopilot's own seconds; answers are no stream."""
        clock = [one.message.time_boot_ms for one in heard if one.message.get_type() == "ATTITUDE"]
        seconds = (clock[-1] - clock[0]) / 1000 * len(clock) / (len(clock) - 1)
        counts: Counter[str] = Counter()
        sizes: Counter[str] = Counter()
        for one in heard:
            kind = one.kind
            if kind in ("COMMAND_ACK", "STATUSTEXT", "PARAM_VALUE"):
                continue
            counts[kind] += 1
            sizes[kind] += one.size_bytes
        self.case.streams = {
            kind: (round(count / seconds, 2), round(sizes[kind] / count, 1)) for kind, count in sorted(counts.items())
        }

    # -- what is sent -------------------------------------------------------------------------------------------

    def command(self, name: str, number: int, *params: float) -> str | None:
        """COMMAND_LONG; its result, None where nothing answers."""
        seven = [*params, *[0.0] * (7 - len(params))]
        return self._ask(name, mavlink.MAVLink_command_long_message(self._system, 1, number, 0, *seven))

    def command_int(
        self, name: str, number: int, *params: float, x: int, y: int, z: float, frame: int = 0
    ) -> str | None:
        four = [*params, *[0.0] * (4 - len(params))]
        return self._ask(
            name, mavlink.MAVLink_command_int_message(self._system, 1, frame, number, 0, 0, *four, x, y, z)
        )

    def arm(self) -> str | None:
        return self.command("arm", mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)

    def disarm(self) -> str | None:
        return self.command("disarm", mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0)

    def takeoff(self, height_m: float) -> str | None:
        amsl_m = self.last["GLOBAL_POSITION_INT"].alt / 1000 - self.position[2] + height_m
        return self.command("takeoff", mavlink.MAV_CMD_NAV_TAKEOFF, *self.manners.takeoff_params(amsl_m, height_m))

    def land(self) -> str | None:
        return self.command("land", mavlink.MAV_CMD_NAV_LAND, *[self.manners.unused] * 7)

    def rest(self) -> str | None:
        """Into the mode in which it waits."""
        return self.set_mode(self.manners.rest)

    @property
    def rests(self) -> bool:
        return self.mode == self.manners.rest

    def set_mode(self, mode: str) -> str | None:
        return self.command(f"mode {mode}", mavlink.MAV_CMD_DO_SET_MODE, *self.manners.mode_params(mode))

    def goto(
        self, north_m: float, east_m: float, up_m: float, name: str = "goto", frame: int = mavlink.MAV_FRAME_GLOBAL_INT
    ) -> str | None:
        """To metres of where the case began, by DO_REPOSITION; its altitude is above mean sea level whatever the frame.

        PX4 main refused every other frame for a while.
        """
        here, at = self.last["GLOBAL_POSITION_INT"], self.position
        radius_m = 6_371_000.0
        x = here.lat + math.degrees((north_m - at[0]) / radius_m) * 1e7
        y = here.lon + math.degrees((east_m - at[1]) / (radius_m * math.cos(math.radians(here.lat / 1e7)))) * 1e7
        z = here.alt / 1000 - at[2] + up_m
        return self.command_int(
            name, mavlink.MAV_CMD_DO_REPOSITION, -1, 1, 0, self.manners.unused, x=round(x), y=round(y), z=z, frame=frame
        )

    def stop_here(self) -> str | None:
        """The mode that does it, or DO_REPOSITION to the place where it is."""
        if self.manners.brake is not None:
            return self.set_mode(self.manners.brake)
        return self.command_int(
            "stop",
            mavlink.MAV_CMD_DO_REPOSITION,
            -1,
            1,
            0,
            NAN,
            x=CURRENT,
            y=CURRENT,
            z=NAN,
            frame=mavlink.MAV_FRAME_GLOBAL_INT,
        )

    def ask(self) -> None:
        """For the messages of which an autopilot says nothing by itself."""
        for name, hz in self.manners.asks.items():
            self._ask_interval(name, 1e6 / hz)

    def unask(self, name: str) -> None:
        """A message as often as the autopilot says it by itself."""
        self._ask_interval(name, 0.0)

    def _ask_interval(self, name: str, interval_us: float) -> None:
        wanted = (mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 0, number(name), interval_us, *[0.0] * 5)
        self.send(mavlink.MAVLink_command_long_message(self._system, 1, *wanted))

    def velocity(self, north: float, east: float, down: float) -> None:
        """One set-point for offboard control."""
        mask = 0b1111_1100_0111
        self._channel.send(
            mavlink.MAVLink_set_position_target_local_ned_message(
                *(0, self._system, 1, mavlink.MAV_FRAME_LOCAL_NED, mask),
                *(0, 0, 0, north, east, down, 0, 0, 0, 0, 0),
            )
        )

    def send(self, message: Any) -> None:
        self._channel.send(message)

    def parameter(self, name: str) -> float | None:
        """A parameter's value; None for an unknown one."""
        self.last.pop("PARAM_VALUE", None)
        for _ in range(3):
            self.send(mavlink.MAVLink_param_request_read_message(self._system, 1, name.encode(), -1))
            end_s = self._channel.now_s + 0.4
            while self._channel.now_s < end_s:
                self._listen(0.02)
                found = self.last.get("PARAM_VALUE")
                if found is not None and found.param_id == name:
                    return self.manners.parameter_value(found)
        return None

    def set_parameter(self, name: str, value: float, *, is_int: bool = False) -> None:
        """Raises Timeout unless the autopilot says that value afterwards."""
        for _ in range(5):
            self.send(self.manners.parameter_set(self._system, name, value, is_int))
            if (now := self.parameter(name)) is not None and math.isclose(now, value, rel_tol=1e-5):
                return
        raise Timeout(f"parameter {name} is not {value}")

    def _ask(self, name: str, message: Any) -> str | None:
        self._results.clear()
        self._asked = message.command
        self._commanded_s, given_up_s = self._clock_s, self._channel.now_s + PATIENCE * ANSWER_S
        self.send(message)
        while not self._results and self._clock_s < self._commanded_s + ANSWER_S and self._channel.now_s < given_up_s:
            self._listen(0.01)
        if self._results:
            self._listen(SECOND_ANSWER_S)
        result = " then ".join(self._results) or None
        self._asked = -1
        self.case.acks.append((name, result))
        return result

    # -- what is heard ------------------------------------------------------------------------------------------

    def _listen(self, seconds: float) -> None:
        now_s = self._channel.now_s
        if now_s >= self._heartbeat_due_s:
            self._heartbeat_due_s = now_s + HEARTBEAT_S
            self.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
        if now_s >= self._asks_due_s and not self.manners.asks.keys() <= self.last.keys():
            self._asks_due_s = now_s + ASKS_S
            self.ask()
        if self.repeat is not None and now_s >= self._repeat_due_s:
            self._repeat_due_s = now_s + 0.1
            self.repeat()
        for heard in self._channel.listen(seconds):
            self._take(heard)
        if self._clock_s >= self._track_due_s and "LOCAL_POSITION_NED" in self.last:
            self._track_due_s += 1.0
            self.case.track.append((round(self.now_s, 1), *(round(value, 2) for value in self.position)))

    def _take(self, heard: Heard) -> None:
        message = heard.message
        if heard.system != self._system:
            return
        kind = heard.kind
        self.last[kind] = message
        if kind in _CLOCKS:
            self._boot_s = message.time_boot_ms / 1000
        if kind == "COMMAND_ACK" and message.command == self._asked:
            self._results.append(RESULTS.get(message.result, str(message.result)))
        elif kind == "HEARTBEAT" and message.autopilot != mavlink.MAV_AUTOPILOT_INVALID:
            self._change("armed", str(bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)).lower())
            self._change("mode", self.manners.mode_name(message.custom_mode))
        elif kind == "EXTENDED_SYS_STATE":
            self._change("landed_state", LANDED.get(message.landed_state, "undefined"))
        for tap in self._taps:
            tap(heard)

    def _change(self, what: str, value: str) -> None:
        if self._known.get(what) != value:
            if what in self._known:
                self.case.events.append((round(self.now_s, 2), what, value))
            self._known[what] = value
