"""The message set over MAVLink: MAVSDK's calls, which return at the acknowledgement, and its subscriptions."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import AsyncGenerator, Callable, Iterator
from dataclasses import asdict
from typing import Any

from mavsdk.asyncio.plugins.offboard import OffboardAsync
from mavsdk.plugins.offboard import OffboardError, VelocityNedYaw

from mqttxt import Word

from .events import EventLog
from .fleet import CommandResult, MissionError, StateValue
from .mavsdk_calls import go_to, take_off
from .mavsdk_drone import FIVE_STATES_HZ, MavsdkDrone
from .mavsdk_fleet import Ask, MavsdkFleet
from .mavsdk_outcomes import mode_of, place_of, refusal
from .message_set import HOVER_M
from .points import points_of

RATE_LIMIT_S = 30.0
REPEATED_S = 0.5
"""MAVSDK repeats a command that is not acknowledged for this long."""
logger = logging.getLogger("mission")


class MavsdkMessageFleet(MavsdkFleet):
    """One drone, for the message set."""

    def __init__(
        self, urls: tuple[str, ...], fogs: dict[int, tuple[int, ...]], commanding: str, streams: str, log: EventLog
    ) -> None:
        super().__init__(urls, fogs, commanding, streams, log)
        self.tells_faster = streams != "five-states"
        self._number = self.drones[0]
        self._offboard: OffboardAsync | None = None
        self._is_in_offboard = False
        self._copies_until_s = 0.0
        self._telling: asyncio.Task[None] | None = None

    async def close(self) -> None:
        await self._end_telling()
        await super().close()

    async def changed(self) -> None:
        """Return when a message arrived since the last call. A silent drone is no error: it may return."""
        self._news.clear()
        await self._news.wait()

    async def call(self, call: int, name: str) -> CommandResult:
        asks: dict[str, Ask] = {
            "arm": lambda drone: drone.action.arm(),
            "takeoff": lambda drone: take_off(drone, HOVER_M),
            "land": lambda drone: drone.action.land(),
            "offboard": self._enter_offboard,
            "goto": lambda drone: go_to(drone, points_of([drone.number])[drone.number]),
        }
        with self._noting_copies():
            try:
                accepted = await self._call_as(call, self._drone, name, asks[name])
            except OffboardError as error:
                return self._note(call, name, self._drone, *refusal(error.result))
            return accepted if isinstance(accepted, CommandResult) else CommandResult(self._number, Word.ACCEPTED.label)

    async def settle(self) -> bool:
        """End offboard's set-points, and wait for copies of the last call, which itself ended when it returned."""
        await self._wait_for_copies()
        if self._is_in_offboard and self._offboard is not None:
            self._is_in_offboard = False
            with self._noting_copies():
                try:
                    await self._calls.run(self._offboard.stop())
                except OffboardError as error:  # the set-points have ended anyway
                    logger.warning("offboard: %s", error)
            await self._wait_for_copies()
        return True

    def follows(self, armed: bool) -> bool:
        """Hold counts too: MAVSDK first changes the mode, unless it knows the drone in hold."""
        status = self.status(self._number)
        return status.armed is armed and status.mode == "hold"

    async def stop_fixed_rates(self) -> None:
        if not self.tells_faster:
            for name in ("battery", "location", "groundspeed"):
                await self._ask_rate(name, 0.0)

    async def request_state(self, name: str) -> asyncio.Queue[StateValue]:
        await self._end_telling()
        told: asyncio.Queue[StateValue] = asyncio.Queue()
        values, form = self._subscription(name)
        self._telling = asyncio.create_task(_take(values, form, told))
        if not self.tells_faster:
            await self._ask_rate(name, FIVE_STATES_HZ)
        return told

    async def stop_state(self, name: str) -> None:
        await self._end_telling()
        try:
            if not self.tells_faster:
                await self._ask_rate(name, 0.0)
        except MissionError as error:
            logger.warning("%s", error)

    @property
    def _drone(self) -> MavsdkDrone:
        return self._drones[self._number]

    @contextlib.contextmanager
    def _noting_copies(self) -> Iterator[None]:
        """Note until when answers to the copies of a call may arrive; an acknowledgement does not name its call.

        A copy and its answer take no longer than the call itself took.
        """
        clock = asyncio.get_running_loop().time
        asked_s = clock()
        try:
            yield
        finally:
            now_s = clock()
            self._copies_until_s = now_s + (now_s - asked_s) if now_s - asked_s >= REPEATED_S else now_s

    async def _wait_for_copies(self) -> None:
        left_s = self._copies_until_s - asyncio.get_running_loop().time()
        if left_s > 0:
            await asyncio.sleep(left_s)

    async def _enter_offboard(self, drone: MavsdkDrone) -> None:
        """Send a set-point, then change the mode; MAVSDK repeats the set-point twenty times per second."""
        if self._offboard is None:
            self._offboard = OffboardAsync(drone.system)
        self._is_in_offboard = True
        await self._offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.0, 0.0, 0.0))
        await self._offboard.start()

    def _subscription(self, name: str) -> tuple[AsyncGenerator[Any, None], Callable[[Any], dict[str, Any]]]:
        """MAVSDK's subscription to a state, and the conversion to MQTT-XT's values."""
        telemetry = self._drone.telemetry
        if name == "battery":
            return telemetry.subscribe_battery(), lambda told: {"remaining_pct": round(told.remaining_percent)}
        if name == "location":
            return telemetry.subscribe_position(), lambda told: asdict(place_of(told))
        if name == "groundspeed":
            return telemetry.subscribe_fixedwing_metrics(), lambda told: {"groundspeed_m_s": told.groundspeed_m_s}
        if name == "flight_mode":
            return telemetry.subscribe_flight_mode(), lambda told: {"mode": mode_of(told).label}
        return telemetry.subscribe_heading(), lambda told: {"heading_deg": told.heading_deg}

    async def _ask_rate(self, name: str, rate_hz: float) -> None:
        try:
            async with asyncio.timeout(RATE_LIMIT_S):
                with self._noting_copies():
                    await self._drone.ask_rate(name, rate_hz)
                await self._wait_for_copies()  # each copy makes the autopilot send a value at once
        except TimeoutError:
            raise MissionError(f"rate of {name}: no answer within {RATE_LIMIT_S:g} s") from None

    async def _end_telling(self) -> None:
        telling, self._telling = self._telling, None
        if telling is not None:
            telling.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await telling


async def _take(
    values: AsyncGenerator[Any, None], form: Callable[[Any], dict[str, Any]], told: asyncio.Queue[StateValue]
) -> None:
    async with contextlib.aclosing(values):
        async for value in values:
            told.put_nowait(StateValue(form(value), age_ms=None))
