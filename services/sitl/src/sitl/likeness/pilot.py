"""Flies an autopilot: sends commands, set-points and requests for messages."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import development as mavlink

from ..streams import number
from .channel import Channel, Heard
from .manners import Manners
from .observer import PATIENCE, Observer, Timeout

ANSWER_S = 1.5
"""A command without an answer by then counts as unanswered."""
SECOND_ANSWER_S = 0.1
"""PX4 answers some commands twice."""
HEARTBEAT_S = 1.0
ASKS_S = 1.0
"""The interval at which missing messages are requested."""
RESULTS = {n: entry.name.removeprefix("MAV_RESULT_").lower() for n, entry in mavlink.enums["MAV_RESULT"].items()}
RESULTS[9] = "command_unsupported_mav_frame"
CURRENT = 0x7FFFFFFF
NAN = math.nan


class Pilot(Observer):
    """Commands an autopilot, over the link on which it is observed. One that `greets` sends heartbeats."""

    def __init__(self, channel: Channel, manners: Manners, system: int, *, greets: bool = True) -> None:
        super().__init__(channel, manners, system)
        self._heartbeat_due_s = -math.inf if greets else math.inf
        self._asks_due_s = -math.inf
        self.repeat: Callable[[], None] | None = None
        """Called ten times per second while it listens: a stream of set-points."""
        self._repeat_due_s = -math.inf

    def _send_what_is_due(self, now_s: float) -> None:
        if now_s >= self._heartbeat_due_s:
            self._heartbeat_due_s = now_s + HEARTBEAT_S
            self.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
        if now_s >= self._asks_due_s and not self.manners.asks.keys() <= self.last.keys():
            self._asks_due_s = now_s + ASKS_S
            self.ask()
        if self.repeat is not None and now_s >= self._repeat_due_s:
            self._repeat_due_s = now_s + 0.1
            self.repeat()

    def command(self, name: str, number: int, *params: float) -> str | None:
        """Send COMMAND_LONG; returns its result, None if there is no answer."""
        return self._ask(name, self._long(number, *params))

    def _long(self, command: int, *params: float) -> Any:
        """COMMAND_LONG; parameters that are not given are 0."""
        seven = [*params, *[0.0] * (7 - len(params))]
        return mavlink.MAVLink_command_long_message(self.system, 1, command, 0, *seven)

    def command_int(
        self, name: str, number: int, *params: float, x: int, y: int, z: float, frame: int = 0
    ) -> str | None:
        four = [*params, *[0.0] * (4 - len(params))]
        return self._ask(name, mavlink.MAVLink_command_int_message(self.system, 1, frame, number, 0, 0, *four, x, y, z))

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
        """Enter the mode in which it waits."""
        return self.set_mode(self.manners.rest)

    @property
    def rests(self) -> bool:
        return self.mode == self.manners.rest

    def set_mode(self, mode: str) -> str | None:
        return self.command(f"mode {mode}", mavlink.MAV_CMD_DO_SET_MODE, *self.manners.mode_params(mode))

    def goto(
        self, north_m: float, east_m: float, up_m: float, name: str = "goto", frame: int = mavlink.MAV_FRAME_GLOBAL_INT
    ) -> str | None:
        """Fly to metres from where the case began, by DO_REPOSITION; its altitude is AMSL whatever the frame.

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
        """Stop by the mode for that, or by DO_REPOSITION to the present place."""
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

    def begin_mission(self) -> str | None:
        """Send MISSION_START: on the ground the mode alone may wait for a stick."""
        return self.command("mission start", mavlink.MAV_CMD_MISSION_START)

    def ask(self) -> None:
        """Request the messages that the autopilot sends only on request."""
        for name, hz in self.manners.asks.items():
            self.ask_for(name, hz)

    def ask_for(self, name: str, hz: float) -> None:
        """Request a message at a rate."""
        self._ask_interval(name, 1e6 / hz)

    def unask(self, name: str) -> None:
        """Set a message back to the autopilot's default rate."""
        self._ask_interval(name, 0.0)

    def _ask_interval(self, name: str, interval_us: float) -> None:
        self.send(self._long(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, number(name), interval_us))

    def velocity(self, north: float, east: float, down: float) -> None:
        """Send one set-point for offboard control, in metres per second."""
        mask = 0b1111_1100_0111
        self._channel.send(
            mavlink.MAVLink_set_position_target_local_ned_message(
                time_boot_ms=0,
                target_system=self.system,
                target_component=1,
                coordinate_frame=mavlink.MAV_FRAME_LOCAL_NED,
                type_mask=mask,
                x=0,
                y=0,
                z=0,
                vx=north,
                vy=east,
                vz=down,
                afx=0,
                afy=0,
                afz=0,
                yaw=0,
                yaw_rate=0,
            )
        )

    def send(self, message: Any) -> None:
        self._channel.send(message)

    def parameter(self, name: str) -> float | None:
        """A parameter's value; None for an unknown one."""
        self.last.pop("PARAM_VALUE", None)
        for _ in range(3):
            self.send(mavlink.MAVLink_param_request_read_message(self.system, 1, name.encode(), -1))
            end_s = self._channel.now_s + 0.4
            while self._channel.now_s < end_s:
                self._listen(0.02)
                found = self.last.get("PARAM_VALUE")
                if found is not None and found.param_id == name:
                    return self.manners.parameter_value(found)
        return None

    def set_parameter(self, name: str, value: float) -> None:
        """Set a parameter. Raises Timeout unless the autopilot reports that value afterwards."""
        for _ in range(5):
            self.send(
                mavlink.MAVLink_param_set_message(self.system, 1, name.encode(), value, mavlink.MAV_PARAM_TYPE_REAL32)
            )
            if (now := self.parameter(name)) is not None and math.isclose(now, value, rel_tol=1e-5):
                return
        raise Timeout(f"parameter {name} is not {value}")

    def _ask(self, name: str, message: Any) -> str | None:
        results: list[str] = []

        def take(heard: Heard) -> None:
            if heard.kind == "COMMAND_ACK" and heard.message.command == message.command:
                results.append(RESULTS.get(heard.message.result, str(heard.message.result)))

        self.tap(take)
        self.mark()
        given_up_s = self._channel.now_s + PATIENCE * ANSWER_S
        self.send(message)
        while not results and self._clock_s < self._commanded_s + ANSWER_S and self._channel.now_s < given_up_s:
            self._listen(0.01)
        if results:
            self._listen(SECOND_ANSWER_S)
        self.untap(take)
        result = " then ".join(results) or None
        self.case.acks.append((name, result))
        return result
