"""A station of several fleets in one process, which commands their drones.

`load_station FLEETS PLAN EVERY_S FOLDER`; FLEETS and PLAN are JSON, `{prefix: [cloud broker, identity or null], …}` and
`[[prefix, fog, first drone, last], …]`. Every drone is armed and disarmed in turn, a command each EVERY_S seconds. Once
all drones are reachable, FOLDER gets `station.ready`. After SIGTERM it sends no more, waits for the last words, and
writes `station.json`: `{"commands": {prefix + fog + / + drone: [[sent, word, reason], …]}, "silent": names of drones
whose last word is missing, "ages_s": of the newest location of each drone, ranked}`.
"""

from __future__ import annotations

import asyncio
import json
import random
import signal
import sys
import time
from contextlib import AsyncExitStack
from pathlib import Path

from mqttxt import Drone, GroundStation, Location

REACHABLE_S = 300.0
TTL_S = 5.0
LAST_WORDS_S = 60.0


class Commanded:
    """A drone, and the outcomes of the commands to it."""

    def __init__(self, drone: Drone) -> None:
        self.drone = drone
        self.said: list[tuple[float, str, str | None]] = []
        self.waits = False

    async def command(self, every_s: float, ended: asyncio.Event) -> None:
        """Arm and disarm it in turn."""
        await asyncio.sleep(random.random() * every_s)
        while not ended.is_set():
            sent_s = time.monotonic()
            call = self.drone.arm if len(self.said) % 2 == 0 else self.drone.disarm
            self.waits = True
            outcome = await call(ttl_s=TTL_S)
            self.waits = False
            self.said.append((sent_s, outcome.word.name.lower(), outcome.reason))
            try:
                async with asyncio.timeout(max(0.0, sent_s + every_s - time.monotonic())):
                    await ended.wait()
            except TimeoutError:
                continue


async def command(
    fleets: dict[str, tuple[str, str | None]], plan: list[tuple[str, int, int, int]], every_s: float, folder: Path
) -> None:
    drones: dict[str, Commanded] = {}
    no_more, ended = asyncio.Event(), asyncio.Event()
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, no_more.set)
    async with AsyncExitStack() as stack:
        for prefix, (broker, identity) in fleets.items():
            station = await stack.enter_async_context(
                GroundStation(broker, prefix=prefix, bundles=True, identity=identity)
            )
            own = {number: (first, last) for at, number, first, last in plan if at == prefix}
            for fog in await station.connect(own, REACHABLE_S):
                first, last = own[fog.number]
                numbers = range(first, last + 1)
                drones |= {f"{prefix}{fog.number}/{number}": Commanded(fog.drone(number)) for number in numbers}
        async with asyncio.timeout(REACHABLE_S):
            while not all(one.drone.is_reachable and one.drone.is_controlled for one in drones.values()):
                await asyncio.sleep(0.2)
        (folder / "station.ready").touch()
        jobs = [asyncio.create_task(one.command(every_s, ended)) for one in drones.values()]
        await no_more.wait()
        known = [one.drone.state(Location) for one in drones.values()]
        ages_s = [location.age_ms / 1000 for location in known if location is not None and location.age_ms is not None]
        ended.set()
        await asyncio.wait(jobs, timeout=LAST_WORDS_S)
    found = {
        "commands": {name: one.said for name, one in drones.items()},
        "silent": [name for name, one in drones.items() if one.waits],
        "ages_s": sorted(ages_s),
    }
    (folder / "station.json").write_text(json.dumps(found))


if __name__ == "__main__":
    asyncio.run(command(json.loads(sys.argv[1]), json.loads(sys.argv[2]), float(sys.argv[3]), Path(sys.argv[4])))
