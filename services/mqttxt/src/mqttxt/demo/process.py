"""The demo: its parts, the order in which they start and end, and the messages to its user."""

from __future__ import annotations

import asyncio
import importlib.util
import shlex
import signal
import sys
import tempfile
import threading
import webbrowser
from collections.abc import Callable
from functools import partial
from pathlib import Path

from ..core import mosquitto
from ..core.printable import printable
from ..errors import ConfigurationError, FogUnreachable
from ..station.ground_station import GroundStation
from .fleet import DRONES, FOG, fleet_file, places_file
from .parts import DemoProcess
from .ports import HOST, free_ports

CLOUD_PORT = 1890
"""The cloud broker's port, unless it is in use. Not 1883, where an installed Mosquitto often runs."""
PAGE_PORT = 8080
"""The page's port, unless it is in use."""
READY_S = 120.0
"""How long the drones may take to become reachable."""
_KEEPS_USER = "user root\n"
"""Otherwise root's Mosquitto changes its user, and then no longer ends with a demo that is killed (prctl(2))."""
_IN_USE = ("in use", "uses the port")
"""Parts of the messages of Mosquitto and the page about a port that is in use."""
_READY = """\
Ready. Watch and fly the drones in a browser: {page}

Or type in another terminal. --take-over: the page controls the drones, and does so again afterwards.

{activate}  export MQTTXT_CLOUD={cloud}
  mqttxt gs watch --fog {fog}                                               # the drones, until Ctrl-C
  mqttxt gs send arm --fog {fog} --take-over                                # all of them
  mqttxt gs send takeoff 10 --fog {fog} --take-over                         # to 10 m
  mqttxt gs send goto 47.39850 8.54700 15 --fog {fog} --best --take-over    # the drone that arrives first
  mqttxt gs send land --fog {fog} --take-over

Ctrl-C here ends everything."""


class Demo:
    """A cloud broker, an activator with its fog's broker, simulated drones with their UAV clients, and the page.

    Parameters:
        tell: called with each line for the user.
        verbose: also pass on the parts' output.
        open_page: also open the page in a browser.
        tiles: the page's `--tiles`; a file by its absolute path.
        places: the page's `--places`, likewise; None: invented places.
    """

    def __init__(
        self,
        tell: Callable[[str], None],
        verbose: bool = False,
        open_page: bool = False,
        tiles: str | None = None,
        places: str | None = None,
    ) -> None:
        self._tell = tell
        self._verbose = verbose
        self._open_page = open_page
        self._tiles = tiles
        self._places = places
        self._stages: list[list[DemoProcess]] = []
        """The parts of one stage start and end together; the last stage ends first."""
        self._ports = free_ports(CLOUD_PORT)
        self._page_ports = free_ports(PAGE_PORT)
        self._over: asyncio.Future[DemoProcess | None] = asyncio.get_running_loop().create_future()
        """The part that has ended unasked, None if a signal ends the demo."""

    async def run(self) -> None:
        """Run until SIGINT, SIGTERM or SIGHUP, then end every part and remove every file.

        Raises ConfigurationError if something is not installed, PartEnded if a part has ended unasked, and
        FogUnreachable if the drones are not reachable in time.
        """
        broker = _installed()
        browser = _browser() if self._open_page else None
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            asyncio.get_running_loop().add_signal_handler(number, self._end_with, None)
        with tempfile.TemporaryDirectory(prefix="mqttxt-demo-") as name:
            folder = Path(name)
            folder.chmod(0o755)  # Mosquitto gives up root's rights, and reads its files again at SIGHUP
            beginning = asyncio.create_task(self._begin(broker, folder, browser))
            beginning.add_done_callback(self._has_begun)
            try:
                ended = await self._over
                if ended is not None:
                    raise ended.last_words()
                self._tell("ending …")
            finally:
                beginning.cancel()
                await asyncio.wait({beginning})
                await self._end()

    async def _end(self) -> None:
        for stage in reversed(self._stages):
            await asyncio.gather(*(part.end() for part in stage))

    def _end_with(self, part: DemoProcess | None) -> None:
        if not self._over.done():
            self._over.set_result(part)

    def _has_begun(self, beginning: asyncio.Task[None]) -> None:
        error = None if beginning.cancelled() else beginning.exception()
        if error is not None and not self._over.done():
            self._over.set_exception(error)

    async def _begin(self, broker: str, folder: Path, browser: webbrowser.BaseBrowser | None) -> None:
        """Start everything, and wait until the drones can be commanded."""
        self._tell(f"starting a cloud broker, an activator and {len(DRONES)} simulated drones …")
        cloud = await self._start_cloud(broker, folder)
        fog = f"{HOST}:{next(self._ports)}"
        links = {number: f"{HOST}:{next(self._ports)}" for number in DRONES}
        fleet = folder / "fleet.yaml"
        fleet.write_text(fleet_file(), encoding="ascii")
        activator = ("activator", "--fog", f"{FOG}", "--cloud", cloud, "--listen", fog)
        await self._start(folder, self._module("the activator", "mqttxt", *activator, "--drones", _listed(",")))
        standing = ("fly", "--autopilot", "stand-in", "--streams", "px4-normal", "--fleet", str(fleet))
        uav = ("uav", "--all-states", "--broker", f"mqtt://{fog}")
        autopilots, clients = [], []
        for number, link in links.items():
            own = ("--system", f"{number}", "--listen", f"{HOST}:0", "--send", link)
            autopilots.append(self._module(f"drone {number}'s autopilot", "sitl", *standing, *own))
            own = ("--drone", f"{number}", "--autopilot", f"udp:{link}", "--journal", str(folder / f"drone{number}"))
            endurance = ("--endurance-s", f"{DRONES[number].endurance_s}")
            clients.append(self._module(f"drone {number}'s UAV client", "mqttxt", *uav, *own, *endurance))
        await self._start(folder, *autopilots)
        await self._start(folder, *clients)
        page = await self._start_page(folder, cloud)
        self._tell(f"the page: {page}")
        if browser is not None:
            threading.Thread(target=browser.open, args=(page,), daemon=True).start()  # some return when they are closed
        await self._reach_drones(cloud)
        self._tell(_READY.format(activate=_activation(), cloud=cloud, fog=FOG, page=page))

    async def _start_cloud(self, broker: str, folder: Path) -> str:
        """Start the cloud broker at the first port that is free when it listens; returns its address."""
        for port in self._ports:
            configuration = folder / "cloud.conf"
            configuration.write_text(mosquitto.configuration(HOST, port) + _KEEPS_USER, encoding="ascii")
            cloud = self._part("the cloud broker", broker, "-c", str(configuration), sign=mosquitto.RUNNING)
            if await self._listens(folder, cloud):
                return f"mqtt://{HOST}:{port}"
        raise _no_port()

    async def _start_page(self, folder: Path, cloud: str) -> str:
        """Start the page at the first port that is free when it is served; returns its address."""
        places = folder / "places.geojson"
        places.write_text(places_file(), encoding="ascii")
        of_map = ["--places", self._places or str(places)]
        if self._tiles is not None:
            of_map += ["--tiles", self._tiles]
        for port in self._page_ports:
            where = f"{HOST}:{port}"
            options = ("--fog", f"{FOG}", "--cloud", cloud, "--listen", where, "--timeout", f"{READY_S:g}")
            page = self._module("the page", "mqttxt", "gs", "page", *options, *of_map, sign=f"open http://{where}/")
            if await self._listens(folder, page):
                return f"http://{where}/"
        raise _no_port()

    async def _listens(self, folder: Path, part: DemoProcess) -> bool:
        """Start a part; returns False if its port is in use by now. Raises PartEnded."""
        self._stages.append([part])
        await part.start(folder)
        if await part.runs:
            self._watch(part)
            return True
        await part.ended
        why = part.last_words()
        if not any(words in str(why) for words in _IN_USE):
            raise why
        self._stages.pop()
        return False

    async def _start(self, folder: Path, *parts: DemoProcess) -> None:
        self._stages.append([*parts])
        for part in parts:
            await part.start(folder)
            self._watch(part)

    def _watch(self, part: DemoProcess) -> None:
        part.ended.add_done_callback(lambda _: self._end_with(part))

    def _module(self, name: str, *module_and_arguments: str, sign: str = "") -> DemoProcess:
        return self._part(name, sys.executable, "-P", "-m", *module_and_arguments, sign=sign)

    def _part(self, name: str, *command: str, sign: str = "") -> DemoProcess:
        return DemoProcess(name, command, partial(self._on_line, name), sign)

    def _on_line(self, name: str, line: str) -> None:
        if self._verbose:
            self._tell(printable(f"{name}: {line}"))

    async def _reach_drones(self, cloud: str) -> None:
        """Wait until a ground station reaches every drone; raises FogUnreachable."""
        async with GroundStation(cloud, control=False) as station:
            (fog,) = await station.connect([FOG], READY_S)
            away = set(DRONES)
            while away:
                try:
                    await station.wait_until(lambda: any(fog.drone(number).is_reachable for number in away), READY_S)
                except TimeoutError:
                    missing = _listed(", ", away)
                    raise FogUnreachable(f"demo: not reachable within {READY_S:g} s: drones {missing}") from None
                for number in sorted(number for number in away if fog.drone(number).is_reachable):
                    away.discard(number)
                    self._tell(f"drone {number} is ready")


def _no_port() -> ConfigurationError:
    return ConfigurationError(f"demo: no port of {HOST} is free; expected one")


def _installed() -> str:
    """Mosquitto's path; raises ConfigurationError if it, the stand-in or the page's library is not installed."""
    if importlib.util.find_spec("sitl") is None:
        raise ConfigurationError(
            "demo: expected the autopilot stand-in (mqttxt-sitl): in a clone of the repository, "
            "pip install ./services/sitl"
        )
    if importlib.util.find_spec("aiohttp") is None:
        raise ConfigurationError("demo: expected aiohttp, for the page: pip install 'mqttxt[demo]'")
    broker = mosquitto.find()
    if broker is None:
        raise ConfigurationError(f"demo: Mosquitto is not installed; expected Mosquitto 2: {mosquitto.how_to_get()}")
    return broker


def _browser() -> webbrowser.BaseBrowser:
    try:
        return webbrowser.get()
    except webbrowser.Error:
        raise ConfigurationError("demo: --open: expected a browser on this machine") from None


def _listed(separator: str, drones: set[int] | None = None) -> str:
    return separator.join(map(str, sorted(drones if drones is not None else DRONES)))


def _activation() -> str:
    """The line that makes another terminal use the same virtual environment; empty outside of one."""
    script = Path(sys.prefix) / "bin" / "activate"
    return f"  . {shlex.quote(str(script))}\n" if script.exists() else ""
