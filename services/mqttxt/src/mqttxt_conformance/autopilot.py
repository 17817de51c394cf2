"""The kit as an autopilot: it streams as PX4 does, answers as a check demands, and keeps the messages written to it."""

from __future__ import annotations

import asyncio
import contextlib
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from mqttxt.core.clock import SessionClock

from .autopilot_keeps import INT32, REAL32, Logs, Parameters
from .mavlink_signing import Signer

ARM, TAKEOFF, LAND, REPOSITION, SET_MODE = 400, 22, 21, 192, 176
FLIGHT = frozenset({ARM, TAKEOFF, LAND, REPOSITION, SET_MODE})
"""The MAV_CMDs that move a drone; requests for messages are not counted."""
HOLD_MODE, LAND_MODE, TAKEOFF_MODE, POSITION_MODE, OFFBOARD_MODE = (4, 3), (4, 6), (4, 2), (3, 0), (6, 0)
HOME = (473_977_420, 85_455_940, 488_000)
"""Latitude, longitude in 1e-7 degrees; altitude in mm above mean sea level."""
_STREAMED = ("MPC_XY_VEL_MAX", "MPC_XY_CRUISE")
"""The parameters behind states."""
WHOLE, FLOAT, GUARDED = "SDLOG_PROFILE", "MPC_TKO_SPEED", "NAV_DLL_ACT"
"""A parameter that is a whole number, one that is not, and one that is set only if it is enabled (R17.9)."""
STREAM_S = 0.2
GCS = 6
"""MAV_TYPE_GCS."""


@dataclass(frozen=True)
class Manner:
    """The reaction to a MAV_CMD: IN_PROGRESS with `progress`, COMMAND_ACK with `result`, its effect; each if set."""

    result: int | None = 0
    effect: bool = True
    progress: int | None = None


@dataclass(frozen=True)
class Written:
    """A MAVLink message that the implementation wrote, and the time of its arrival in the kit's clock."""

    at_ms: int
    message: Any

    @property
    def command(self) -> int | None:
        return getattr(self.message, "command", None) if "COMMAND_" in self.message.get_type() else None

    @property
    def mode(self) -> tuple[int, int]:
        """The mode that a DO_SET_MODE commands, as PX4 has it."""
        return int(self.message.param2), int(self.message.param3)


class Autopilot:
    """One autopilot over UDP; it sends to the address on which the implementation listens."""

    def __init__(self, host: str, port: int, system: int, clock: SessionClock) -> None:
        self.system = system
        self.armed = False
        self.mode = HOLD_MODE
        self.altitude_mm = 0
        self.landed = 1
        self.silent = False
        self.withheld: frozenset[str] = frozenset()
        """The types of messages that it does not send."""
        self.manners: dict[int, Manner] = {}
        self.parameters = Parameters(
            {**dict.fromkeys((*_STREAMED, FLOAT), (REAL32, 5.0)), WHOLE: (INT32, 1), GUARDED: (INT32, 2)}
        )
        self.logs = Logs()
        self.signer: Signer | None = None
        self.written: list[Written] = []
        self._booted_ms = 0
        self._address = (host, port)
        self._clock = clock
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True
        self._transport: asyncio.DatagramTransport | None = None
        self._task: asyncio.Task[None] | None = None
        self._seq = 0

    async def start(self) -> None:
        """Begin to stream."""
        autopilot = self

        class Protocol(asyncio.DatagramProtocol):
            def datagram_received(self, data: bytes, addr: Any) -> None:
                autopilot._on_datagram(data)

        loop = asyncio.get_running_loop()
        self._transport, _ = await loop.create_datagram_endpoint(Protocol, remote_addr=self._address)
        self._task = asyncio.create_task(self._stream())

    async def close(self) -> None:
        if self._task is not None:
            self._task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._task
        if self._transport is not None:
            self._transport.close()

    def flights(self, mark: int, command: int | None = None) -> list[Written]:
        """The flight commands written since `mark`, or those of one MAV_CMD."""
        wanted = FLIGHT if command is None else {command}
        return [written for written in self.written[mark:] if written.command in wanted]

    def of_type(self, mark: int, kind: str) -> list[Written]:
        return [written for written in self.written[mark:] if written.message.get_type() == kind]

    def send(self, message: Any, component: int = 1, system: int | None = None) -> None:
        """Send a message unless it is withheld, by default from the autopilot's own ids."""
        if self._transport is None or message.get_type() in self.withheld:
            return
        encoder = mavlink.MAVLink(None, srcSystem=system or self.system, srcComponent=component)
        encoder.seq = self._seq = (self._seq + 1) % 256
        if self.signer is not None:
            self.signer.equip(encoder)
        self._transport.sendto(message.pack(encoder))

    def acknowledge(
        self, command: int, result: int, *, progress: int = 0, to: tuple[int, int] | None = None, component: int = 1
    ) -> None:
        """Send COMMAND_ACK to a system and component, by default the companion computer."""
        target = to or (self.system, 191)
        self.send(mavlink.MAVLink_command_ack_message(command, result, progress, 0, *target), component)

    def tell(self) -> None:
        """Send heartbeat, position and landed state at once."""
        base = 1 | (mavlink.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0)
        main, sub = self.mode
        self.send(mavlink.MAVLink_heartbeat_message(2, 12, base, main << 16 | sub << 24, 4, 3))
        latitude, longitude, amsl = HOME
        now_ms, up = (self._clock.now_ms() - self._booted_ms) % 2**32, self.altitude_mm
        self.send(
            mavlink.MAVLink_global_position_int_message(now_ms, latitude, longitude, amsl + up, up, 0, 0, 0, 9000)
        )
        self.send(mavlink.MAVLink_extended_sys_state_message(0, self.landed))

    def reset(self) -> None:
        """Be disarmed, in hold, on the ground, and execute every command."""
        self.manners.clear()
        self.silent, self.withheld, self.parameters.takes_none = False, frozenset(), False
        self.armed, self.mode, self.landed, self.altitude_mm = False, HOLD_MODE, 1, 0

    def boot(self) -> None:
        """Start anew, on the ground for all it knows."""
        self._booted_ms = self._clock.now_ms()
        self.reset()

    async def _stream(self) -> None:
        turn = 0
        while True:
            if not self.silent:
                self.tell()
                if turn % 5 == 0:
                    self._tell_more()
            turn += 1
            await asyncio.sleep(STREAM_S)

    def _tell_more(self) -> None:
        healthy = mavlink.MAV_SYS_STATUS_PREARM_CHECK
        self.send(mavlink.MAVLink_home_position_message(*HOME, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0, 0))
        self.send(mavlink.MAVLink_vfr_hud_message(0, 0, 90, 0, HOME[2] / 1000, 0))
        self.send(
            mavlink.MAVLink_sys_status_message(
                onboard_control_sensors_present=healthy,
                onboard_control_sensors_enabled=healthy,
                onboard_control_sensors_health=healthy,
                load=100,
                voltage_battery=12_000,
                current_battery=0,
                battery_remaining=87,
                drop_rate_comm=0,
                errors_comm=0,
                errors_count1=0,
                errors_count2=0,
                errors_count3=0,
                errors_count4=0,
            )
        )
        cells = [4000] + [65_535] * 9
        self.send(mavlink.MAVLink_battery_status_message(0, 0, 1, 32_767, cells, 0, -1, -1, 87))
        for name in _STREAMED:
            self.send(self.parameters.told(name))

    def _on_datagram(self, data: bytes) -> None:
        at_ms = self._clock.now_ms()
        for message in self._parser.parse_buffer(data) or ():
            if message.get_type() == "BAD_DATA":
                continue
            self.written.append(Written(at_ms, message))
            if message.get_type() in ("COMMAND_LONG", "COMMAND_INT"):
                self._on_command(message)
            for answer in (*self.parameters.answers(message), *self.logs.answers(message)):
                self.send(answer)

    def _on_command(self, message: Any) -> None:
        manner = self.manners.get(message.command, Manner())
        if manner.progress is not None:
            self.acknowledge(message.command, 5, progress=manner.progress, to=_sender(message))
        if manner.result is None:
            return
        self.acknowledge(message.command, manner.result, to=_sender(message))
        if manner.result == 0 and manner.effect and message.command in FLIGHT:
            self._do(message)
            self.tell()

    def _do(self, message: Any) -> None:
        if message.command == ARM:
            self.armed = message.param1 == 1
        elif message.command == SET_MODE:
            self.mode = (int(message.param2), int(message.param3))
        elif message.command == REPOSITION:
            self.mode = HOLD_MODE
        elif message.command == LAND:
            self.mode = LAND_MODE
        elif message.command == TAKEOFF:
            self.mode, self.armed = TAKEOFF_MODE, True


def _sender(message: Any) -> tuple[int, int]:
    return message.get_srcSystem(), message.get_srcComponent()
