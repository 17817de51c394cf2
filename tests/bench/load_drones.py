"""UAV clients by the hundred in one process: `load_drones BROKER PLAN REPORT`.

Each is a whole role with a connection of its own. Beneath it is a light autopilot in place of a link: MAVLink messages
as objects, a few per second. Journals are left out, as a disk's cost is not measured here. One schedule calls all roles
and autopilots in turn, each role ten times per second, the lowest allowed rate: a timer for each of them would cost as
much as the roles do.
PLAN is JSON, `[[root, first, last], …]`: the drones below each root. At the end REPORT gets the commands to each
autopilot: `{"commanded": {root + drone: [[MAV_CMD, seconds of CLOCK_MONOTONIC], …]}, "failed": […]}`.
"""

from __future__ import annotations

import asyncio
import gc
import json
import math
import random
import signal
import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from mqttxt.core.address import BrokerAddress
from mqttxt.core.clock import SessionClock
from mqttxt.core.effects import Inbound
from mqttxt.core.mqtt.link import MqttLink
from mqttxt.core.runner import Runner
from mqttxt.core.settings import Settings, next_turn_ms
from mqttxt.drone.commands import LINK
from mqttxt.drone.effects import Journal, Transmit
from mqttxt.drone.mavlink.sources import Source
from mqttxt.drone.role import UavClient
from mqttxt.protocol.policies import Policy
from mqttxt.protocol.topics import FogSide
from tests.bench.fleet import FIVE

ARMED = mavlink.MAV_MODE_FLAG_SAFETY_ARMED
PX4_HOLD = 4 << 16 | 3 << 24
FASTEST_M_S = 12.0
HOME = 473_977_420, 85_455_940, 488_000
"""Degrees in 1e-7, and millimetres above mean sea level."""
CELLS = [4000] * 4 + [65_535] * 6
"""Millivolts of four cells; there are no others."""
CONNECTS_EVERY_S = 0.002
STEADY = Policy(lambda _old, _new: True, min_interval_ms=800)
"""Puts a state into each bundle, once per second, changed or not; a late one does not delay the next."""
BEAT_MS = 1000
TICKS_PER_S, PARTS = 10, 5
"""How often each role is called, and in how many parts of the drones, one after the other."""


class LightAutopilot:
    """A PX4 on the ground that arms and disarms, reports its place once per second, and records its commands."""

    def __init__(self, system: int) -> None:
        self.commanded: list[tuple[int, float]] = []
        self._system = system
        self._is_armed = False
        self._booted_s = time.monotonic()
        self._turn = random.randrange(1000)

    def beat(self) -> list[Any]:
        """Its messages of a second, with new values each time; some only every other second, as from a PX4."""
        self._turn += 1
        since_boot_ms = round(1000 * (time.monotonic() - self._booted_s))
        angle, up_mm = self._turn / 20 % math.tau, 100 * (self._turn % 9)
        place = HOME[0] + round(2000 * math.sin(angle)), HOME[1] + round(2000 * math.cos(angle)), HOME[2] + up_mm, up_mm
        heading = round(100 * math.degrees(angle))
        said = [
            self._heartbeat(),
            mavlink.MAVLink_global_position_int_message(since_boot_ms, *place, 0, 0, 0, heading),
            mavlink.MAVLink_vfr_hud_message(0.0, self._turn % 12 + 0.5, 0, 0, 0.0, 0.0),
        ]
        if self._turn % 2 == 0:
            left = 99 - self._turn // 2 % 80
            said += [
                mavlink.MAVLink_battery_status_message(0, 0, 1, 32_767, CELLS, -1, -1, -1, left),
                mavlink.MAVLink_extended_sys_state_message(0, mavlink.MAV_LANDED_STATE_ON_GROUND),
            ]
        return self._signed(said)

    def take(self, message: Any, source: Source) -> list[Any]:
        """Its answers to a message that its UAV client writes in the name of `source`."""
        kind = message.get_type()
        if kind == "PARAM_REQUEST_READ":
            value = mavlink.MAVLink_param_value_message(message.param_id.encode(), FASTEST_M_S, 9, 1, 65_535)
            return self._signed([value])
        if kind != "COMMAND_LONG":
            return []
        said = []
        if message.command == mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
            self.commanded.append((message.command, time.monotonic()))
            self._is_armed = message.param1 == 1
        elif (
            message.command == mavlink.MAV_CMD_REQUEST_MESSAGE
            and message.param1 == mavlink.MAVLINK_MSG_ID_HOME_POSITION
        ):
            said.append(mavlink.MAVLink_home_position_message(*HOME, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0, 0))
        asked = source.system(self._system), source.component
        said.append(mavlink.MAVLink_command_ack_message(message.command, mavlink.MAV_RESULT_ACCEPTED, 0, 0, *asked))
        return self._signed([*said, self._heartbeat()])

    def _heartbeat(self) -> Any:
        return mavlink.MAVLink_heartbeat_message(2, 12, 1 | (ARMED if self._is_armed else 0), PX4_HOLD, 4, 3)

    def _signed(self, messages: list[Any]) -> list[Any]:
        """Give messages the autopilot's ids."""
        for message in messages:
            message._header = mavlink.MAVLink_header(message.id, srcSystem=self._system, srcComponent=1)
        return messages


class LightRunner(Runner):
    """Runs one UAV client on a light autopilot. It has no clock of its own: `turn` is called `TICKS_PER_S` times."""

    def __init__(self, drone: int, broker: BrokerAddress, root: str) -> None:
        clock = SessionClock()
        policies = {state.name: STEADY for state in FIVE}
        self.client = UavClient(drone, clock.session, Settings(bundles=True), FogSide(root), policies)
        super().__init__(self.client, clock)
        self.autopilot = LightAutopilot(drone)
        self._answers: list[Any] = []
        self._depth = 0
        self._next_beat_ms = 0
        self.links[LINK] = MqttLink(LINK, broker, f"load-{root}{drone}-{clock.session:08x}", self.client.will, self)
        self.does |= {Transmit: self._transmit, Journal: self._journal}

    def jobs(self) -> list[Any]:
        return [link.run() for link in self.links.values()]

    def turn(self) -> None:
        """Do what is due at the autopilot and at the role."""
        self._beat()
        self.carry_out(self.client.tick(self.clock.now_ms()))

    def carry_out(self, outputs: Iterable[Any]) -> None:
        """Carry out outputs, and let the autopilot answer after all of them: a turn of a full process may take longer
        than a UAV client waits before it repeats a message.
        """
        self._depth += 1
        super().carry_out(outputs)
        self._depth -= 1
        while self._answers and self._depth == 0:
            answers, self._answers = self._answers, []
            self._hear(answers)

    def received(self, link: str, message: Inbound) -> None:
        """Let the autopilot send first: a real one would have gone on while this process had no processor."""
        self._beat()
        super().received(link, message)

    def _beat(self) -> None:
        now_ms = self.clock.now_ms()
        if now_ms >= self._next_beat_ms:
            self._next_beat_ms = next_turn_ms(self._next_beat_ms, now_ms, BEAT_MS)
            self._hear(self.autopilot.beat())

    def _journal(self, output: Journal) -> None:
        if output.is_opening:
            self.carry_out(self.client.desk.on_journalled(output.id, self.clock.now_ms()))

    def _transmit(self, effect: Transmit) -> None:
        """Write as a UAV client's own runner does: it reads the clock for the last time before the write."""
        late = effect.not_after_ms is not None and self.clock.now_ms() > effect.not_after_ms
        if not late:
            self._answers += self.autopilot.take(effect.message, effect.source)
        if effect.ref is None:
            return
        if late:
            self.carry_out(self.client.on_refused(effect.ref, late, self.clock.now_ms()))
        else:
            self.carry_out(self.client.on_transmitted(effect.ref, self.clock.now_ms()))

    def _hear(self, messages: list[Any]) -> None:
        for message in messages:
            self.carry_out(self.client.on_mavlink(message, self.clock.now_ms()))


async def turn(runners: list[LightRunner]) -> None:
    """Call all runners for ever, including those that are added meanwhile; missed calls are not made up for."""
    loop, pause_s = asyncio.get_running_loop(), 1 / (TICKS_PER_S * PARTS)
    due_s, part = loop.time(), 0
    while True:
        for runner in runners[part::PARTS]:
            runner.turn()
        part = (part + 1) % PARTS
        due_s = max(due_s + pause_s, loop.time())
        await asyncio.sleep(due_s - loop.time())


async def fly(broker: str, plan: list[tuple[str, int, int]], report: Path) -> None:
    """Run until SIGTERM; then say goodbye, and write the report."""
    address, ended = BrokerAddress.parse(broker), asyncio.Event()
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, ended.set)
    drones = [(root, number) for root, first, last in plan for number in range(first, last + 1)]
    names: list[str] = []
    runners: list[LightRunner] = []
    running: list[asyncio.Task[None]] = []
    turning = asyncio.create_task(turn(runners))
    for root, number in drones:
        names.append(f"{root}{number}")
        runners.append(LightRunner(number, address, root))
        running.append(asyncio.create_task(runners[-1].run()))
        await asyncio.sleep(CONNECTS_EVERY_S)
    gc.freeze()  # thousands of objects that last: no collection has to walk over them
    ending = asyncio.create_task(ended.wait())
    await asyncio.wait((ending, turning), return_when=asyncio.FIRST_COMPLETED)
    if turning.done():
        turning.result()
    failed = [repr(task.exception()) for task in running if task.done()]
    for task in (turning, *running):
        task.cancel()
    await asyncio.gather(*running, return_exceptions=True)
    commanded = {name: runner.autopilot.commanded for name, runner in zip(names, runners, strict=True)}
    report.write_text(json.dumps({"commanded": commanded, "failed": failed}))


if __name__ == "__main__":
    asyncio.run(fly(sys.argv[1], json.loads(sys.argv[2]), Path(sys.argv[3])))
