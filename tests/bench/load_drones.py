"""UAV clients by the hundred in one process: `load_drones BROKER PLAN REPORT`.

Each is a whole role with a connection of its own. Beneath it is a light autopilot in place of a link: MAVLink messages
as objects, a few a second. Journals are left out: a disk's cost is not what is measured.
PLAN is JSON, `[[root, first, last], …]`: the drones below each root. REPORT gets at the end what each autopilot was
told to do: `{"commanded": {root + drone: [[MAV_CMD, seconds of CLOCK_MONOTONIC], …]}, "failed": […]}`.
"""

from __future__ import annotations

import asyncio
import json
import math
import random
import signal
import sys
import time
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from mqttxt.core.clock import SessionClock
from mqttxt.core.mqtt.link import BrokerAddress, MqttLink
from mqttxt.core.runner import Runner
from mqttxt.core.settings import Settings
from mqttxt.drone.commands import LINK
from mqttxt.drone.effects import Journal, Transmit
from mqttxt.drone.mavlink.sources import Source
from mqttxt.drone.role import UavClient
from mqttxt.protocol.topics import FogSide
from tests.bench.fleet import FIVE
from tests.bench.steady_uav import STEADY

ARMED = mavlink.MAV_MODE_FLAG_SAFETY_ARMED
PX4_HOLD = 4 << 16 | 3 << 24
FASTEST_M_S = 12.0
HOME = 473_977_420, 85_455_940, 488_000
"""Degrees in 1e-7, and millimetres above mean sea level."""
CONNECTS_EVERY_S = 0.002


class LightAutopilot:
    """A PX4 on the ground that arms and disarms, says where it is once a second, and notes what it was told to do."""

    def __init__(self, system: int, hear: Any) -> None:
        self.commanded: list[tuple[int, float]] = []
        self._system = system
        self._hear = hear
        self._is_armed = False
        self._booted_s = time.monotonic()
        self._turn = random.randrange(1000)

    def beat(self) -> None:
        """What it says every second, another value each time."""
        self._turn += 1
        since_boot_ms = round(1000 * (time.monotonic() - self._booted_s))
        angle, up_mm = self._turn / 20 % math.tau, 100 * (self._turn % 9)
        place = HOME[0] + round(2000 * math.sin(angle)), HOME[1] + round(2000 * math.cos(angle)), HOME[2] + up_mm, up_mm
        self._say(self._heartbeat())
        self._say(
            mavlink.MAVLink_global_position_int_message(
                since_boot_ms, *place, 0, 0, 0, round(100 * math.degrees(angle))
            )
        )
        self._say(mavlink.MAVLink_vfr_hud_message(0.0, self._turn % 12 + 0.5, 0, 0, 0.0, 0.0))
        cells = [4000] * 4 + [65_535] * 6
        battery = mavlink.MAVLink_battery_status_message(0, 0, 1, 32_767, cells, -1, -1, -1, 99 - self._turn // 10 % 80)
        self._say(battery)
        self._say(mavlink.MAVLink_extended_sys_state_message(0, mavlink.MAV_LANDED_STATE_ON_GROUND))

    def take(self, message: Any, source: Source) -> None:
        """What its UAV client writes to it, in the name of `source`."""
        kind = message.get_type()
        if kind == "PARAM_REQUEST_READ":
            self._say(mavlink.MAVLink_param_value_message(message.param_id.encode(), FASTEST_M_S, 9, 1, 65_535))
        if kind != "COMMAND_LONG":
            return
        if message.command == mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
            self.commanded.append((message.command, time.monotonic()))
            self._is_armed = message.param1 == 1
        elif (
            message.command == mavlink.MAV_CMD_REQUEST_MESSAGE
            and message.param1 == mavlink.MAVLINK_MSG_ID_HOME_POSITION
        ):
            self._say(mavlink.MAVLink_home_position_message(*HOME, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0, 0))
        asked = source.system(self._system), source.component
        self._say(mavlink.MAVLink_command_ack_message(message.command, mavlink.MAV_RESULT_ACCEPTED, 0, 0, *asked))
        self._say(self._heartbeat())

    def _heartbeat(self) -> Any:
        return mavlink.MAVLink_heartbeat_message(2, 12, 1 | (ARMED if self._is_armed else 0), PX4_HOLD, 4, 3)

    def _say(self, message: Any) -> None:
        message._header = mavlink.MAVLink_header(message.id, srcSystem=self._system, srcComponent=1)
        self._hear(message)


class LightRunner(Runner):
    """Runs one UAV client on a light autopilot."""

    def __init__(self, drone: int, broker: BrokerAddress, root: str) -> None:
        clock = SessionClock()
        policies = {state.name: STEADY for state in FIVE}
        self.client = UavClient(drone, clock.session, Settings(bundles=True), FogSide(root), policies)
        super().__init__(self.client, clock)
        self._loop = asyncio.get_running_loop()
        self.autopilot = LightAutopilot(drone, lambda message: self._loop.call_soon(self._on_mavlink, message))
        self.links[LINK] = MqttLink(LINK, broker, f"load-{root}{drone}-{clock.session:08x}", self.client.will, self)
        self.does |= {Transmit: self._transmit, Journal: self._journal}

    def jobs(self) -> list[Any]:
        return [*super().jobs(), self._beat()]

    def _journal(self, output: Journal) -> None:
        if output.is_opening:
            self.carry_out(self.client.desk.on_journalled(output.id, self.clock.now_ms()))

    def _transmit(self, effect: Transmit) -> None:
        """As in a UAV client's own runner: a last look at the clock before the write."""
        late = effect.not_after_ms is not None and self.clock.now_ms() > effect.not_after_ms
        if not late:
            self.autopilot.take(effect.message, effect.source)
        if effect.ref is None:
            return
        if late:
            self.carry_out(self.client.on_refused(effect.ref, late, self.clock.now_ms()))
        else:
            self.carry_out(self.client.on_transmitted(effect.ref, self.clock.now_ms()))

    def _on_mavlink(self, message: Any) -> None:
        self.carry_out(self.client.on_mavlink(message, self.clock.now_ms()))

    async def _beat(self) -> None:
        self.autopilot.beat()  # heard before the broker answers
        await asyncio.sleep(random.random())
        while True:
            self.autopilot.beat()
            await asyncio.sleep(1.0)


async def fly(broker: str, plan: list[tuple[str, int, int]], report: Path) -> None:
    """Run until SIGTERM; then say goodbye, and write the report."""
    address, ended = BrokerAddress.parse(broker), asyncio.Event()
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, ended.set)
    drones = [(root, number) for root, first, last in plan for number in range(first, last + 1)]
    runners = {f"{root}{number}": LightRunner(number, address, root) for root, number in drones}
    running = []
    for runner in runners.values():
        running.append(asyncio.create_task(runner.run()))
        await asyncio.sleep(CONNECTS_EVERY_S)
    await ended.wait()
    failed = [repr(task.exception()) for task in running if task.done()]
    for task in running:
        task.cancel()
    await asyncio.gather(*running, return_exceptions=True)
    commanded = {name: runner.autopilot.commanded for name, runner in runners.items()}
    report.write_text(json.dumps({"commanded": commanded, "failed": failed}))


if __name__ == "__main__":
    asyncio.run(fly(sys.argv[1], json.loads(sys.argv[2]), Path(sys.argv[3])))
