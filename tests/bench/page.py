"""The age of a state when the live page shows it, since its publication by a drone, and the page's process's cost.

Drones that exist only as messages publish five states each at 1 Hz, all of them moving, to a fog's Mosquitto; an
activator and the cloud's Mosquitto bring them to `mqttxt gs page`, which controls the drones and is open in Chromium.
A state is on screen in the frame after its value's change in the table. Chromium and this process share a clock.
"""

from __future__ import annotations

import asyncio
import math
import tempfile
import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from mqttxt.protocol.state_payload import StampedState, decode_state, encode_state
from mqttxt.protocol.states import Battery, FlightMode, FlightModeName, Groundspeed, Heading, Location
from mqttxt.protocol.topics import CloudSide, DroneTopic
from mqttxt.protocol.values import Encoding
from tests.bench.brokers import BenchBroker, cpu_s
from tests.bench.fleet import Fleet
from tests.bench.raw_mqtt import RawClient
from tests.rigs.live_page import LivePage
from tests.rigs.processes import Process, eventually
from tests.rigs.served_page import Served

DRONES = 250
"""As many as there are MAVLink system ids."""
WARM_UP_TURNS, TURNS = 10, 60
"""Turns of one second each, in which every drone publishes every state once."""
PARTS = 50
"""In how many equal parts of a second the drones publish, one after the other."""
DUE_MS = 200.0
WIDTH = 1600
_PROBE = """(() => {
  window.shown = [];
  new MutationObserver(changes => {
    const spans = new Set(changes.map(({target}) => target.nodeType === Node.TEXT_NODE ? target.parentNode : target));
    const found = [...spans].filter(span => span.matches("td[data-heading=Speed] > span"))
      .map(span => [span.closest("tr").dataset.drone, span.textContent]);
    if (found.length) requestAnimationFrame(() => setTimeout(() => {
      const now = Date.now();
      window.shown.push(...found.map(([drone, text]) => [drone, text, now]));
    }));
  }).observe(document.getElementById("fleet-rows"), {subtree: true, childList: true, characterData: true});
})()"""


class Movers(Fleet):
    """Drones on circles of their own, with new values every turn; `said` has when each speed was published, in ms."""

    def __init__(self, port: int, numbers: range, root: str) -> None:
        super().__init__(port, numbers, root)
        self.said: dict[tuple[int, str], float] = {}

    def publish_part(self, turn: int, part: int, parts: int) -> None:
        """Publish the states of those drones that are due in one of `parts` equal slices of a turn."""
        assert self._client is not None
        for number in list(self._sessions)[part::parts]:
            speed = Groundspeed(0.1 * turn)
            angle = 0.05 * turn + number
            row, column = divmod(number, 25)
            place = 47.39 + 0.002 * row + 0.0008 * math.cos(angle), 8.54 + 0.003 * column + 0.0012 * math.sin(angle)
            states = (
                Battery(100 - turn % 90),
                Location(*place, 500.0, 20.0 + turn % 10),
                Heading(math.degrees(angle) % 360),
                FlightMode(FlightModeName.MISSION),
                speed,
            )
            for state in states:
                stamped = StampedState(state, self.stamp())
                self._client.publish(self._topics.state(number, state.name), encode_state(stamped, Encoding.CBOR))
            self.said[number, shown_speed(speed)] = time.time() * 1000


def shown_speed(speed: Groundspeed) -> str:
    """A speed as the page's table shows it."""
    return f"{speed.groundspeed_m_s:.1f} m/s"


@dataclass(frozen=True)
class Shown:
    """Ranked ages in milliseconds, infinite for updates that were never shown; shares of one core."""

    ages_ms: list[float]
    at_broker_ms: list[float]
    page_share: float
    browser_share: float

    @property
    def in_time(self) -> float:
        """The share of the updates that were on screen in time."""
        return sum(age <= DUE_MS for age in self.ages_ms) / len(self.ages_ms)


def measure() -> list[str]:
    """Lines of figures; takes about two minutes."""
    found = asyncio.run(_measure())
    screen, broker = found.ages_ms, found.at_broker_ms
    return [
        f"page: {DRONES} drones at 1 Hz: {100 * found.in_time:.1f} % of {len(screen):,} updates on screen within "
        f"{DUE_MS:.0f} ms (p50 {_at(screen, 0.5):.0f}, p95 {_at(screen, 0.95):.0f}, p99 {_at(screen, 0.99):.0f} ms; at "
        f"the cloud broker p50 {_at(broker, 0.5):.0f}, p95 {_at(broker, 0.95):.0f} ms)",
        f"page: its process takes {100 * found.page_share:.0f} % of a core, Chromium {100 * found.browser_share:.0f} %",
    ]


def _at(ranked: list[float], share: float) -> float:
    return ranked[min(len(ranked) - 1, int(share * len(ranked)))]


async def _measure() -> Shown:
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        cloud, fog = BenchBroker(folder, "cloud"), BenchBroker(folder, "fog")
        for broker in (cloud, fog):
            stack.callback(broker.start().kill)
        options = ["--fog", "1", "--cloud", cloud.url, "--fog-broker", fog.url, "--fog-root", "f1/"]
        ready = ["--ready-file", str(folder / "activator.ready")]
        activator = Process(folder, "activator", "mqttxt", "activator", *options, *ready).start()
        stack.callback(activator.stop)
        await asyncio.to_thread(activator.wait_ready)
        fleet = Movers(fog.port, range(1, DRONES + 1), "f1/")
        await fleet.start()
        stack.callback(fleet.close)
        page = await asyncio.to_thread(Served, folder, cloud, "page")
        stack.callback(page.process.stop)
        heard: dict[tuple[int, str], float] = {}
        listener = await RawClient.connect(cloud.port, "bench-listener", lambda *said: _note(heard, *said))
        stack.callback(listener.close)
        await listener.subscribe("+/+/state/groundspeed")
        browser = stack.enter_context(LivePage())
        await asyncio.to_thread(browser.open, page.url, WIDTH)
        turn = 0
        for turn in range(1, WARM_UP_TURNS + 1):
            await _publish(fleet, turn)
        rows = (
            f"[...document.querySelectorAll('#fleet-rows tr')].filter(r => /{turn / 10:.1f} m.s/.test(r.textContent))"
        )
        await eventually(lambda: len(heard) >= DRONES, "every drone is relayed")
        await asyncio.to_thread(browser.until, f"{rows}.length === {DRONES}", "every drone is shown")
        await asyncio.to_thread(browser.value, _PROBE)
        for collected in (fleet.said, heard):
            collected.clear()
        started, page_s, browser_s = time.monotonic(), cpu_s(page.process.pid), cpu_s(*browser.pids())
        for turn in range(WARM_UP_TURNS + 1, WARM_UP_TURNS + TURNS + 1):
            await _publish(fleet, turn)
        lasted_s = time.monotonic() - started
        page_s, browser_s = cpu_s(page.process.pid) - page_s, cpu_s(*browser.pids()) - browser_s
        rows = rows.replace(f"{WARM_UP_TURNS / 10:.1f}", f"{turn / 10:.1f}")
        await asyncio.to_thread(browser.until, f"{rows}.length === {DRONES}", "the last turn is shown")
        shown = await asyncio.to_thread(browser.value, "window.shown")
        assert browser.said == [], browser.said
    on_screen = {(int(drone.rpartition("/")[2]), text): at for drone, text, at in shown}
    return Shown(
        ages_ms=sorted(on_screen.get(key, math.inf) - at for key, at in fleet.said.items()),
        at_broker_ms=sorted(heard.get(key, math.inf) - at for key, at in fleet.said.items()),
        page_share=page_s / lasted_s,
        browser_share=browser_s / lasted_s,
    )


def _note(heard: dict[tuple[int, str], float], topic: str, payload: bytes) -> None:
    state = decode_state(Groundspeed.name, payload, relayed=True).state
    assert isinstance(state, Groundspeed)
    of = CloudSide(1).parse(topic)
    assert isinstance(of, DroneTopic)
    heard[of.drone, shown_speed(state)] = time.time() * 1000


async def _publish(fleet: Movers, turn: int) -> None:
    """Publish one turn, spread evenly over its second."""
    loop = asyncio.get_running_loop()
    started = loop.time()
    for part in range(PARTS):
        fleet.publish_part(turn, part, PARTS)
        await asyncio.sleep(max(0, started + (part + 1) / PARTS - loop.time()))
