"""The content that browsers are shown, and their requests: the page without its web server."""

from __future__ import annotations

import asyncio
from collections import deque
from dataclasses import asdict
from typing import Any

from ..core.printable import printable
from ..errors import ConfigurationError, MqttxtError
from ..station.fleets import Fleets
from ..station.ground_station import GroundStation
from ..station.outcomes import ControlChanged, Event, PsmiList, QodsRanking, Reachability, StateUpdate
from ..station.plan import Plan
from ..station.views import STALE_MS, TTL_S, Drone, Fog
from .desk import Order, OrderDesk
from .drafts import Draft, draft_of, path_of
from .event_log import EventLog, as_plain
from .fleet import drone_of, fog_of, name_of, standing_of
from .history import ChartKey, History
from .links import Links
from .offers import LONGEST_TTL_S, DroneKey, LinkRequest, LookRequest, catalogue, read_request
from .places import Place
from .tiles import Offer
from .words import why_left_out

REVIEW_S = 0.5
MOST_ENTRIES = 500
"""Log entries in one message; a browser that is further behind misses older ones, which the export has."""
MOST_ANSWERS = 100
MOST_LINES = 10
"""Lines of mistakes in one answer; `mqttxt gs plan upload` prints all of a file's."""
BEAT_MS = 1000
"""An update is due at least this often, be it empty: so a browser notices a program or a tunnel that hangs."""
LOOK_S = 1.0
"""How often the links are read."""
_ONLY_WATCHES = "this page only watches: start it without --watch-only to command"
_NO_LINKS = "this page has no links to change"
_NOT_OPEN = "the page is starting or ending: nothing was sent"


class Viewer:
    """One browser, with everything that it has not been sent yet."""

    def __init__(self, live: Live) -> None:
        self._live = live
        self.drones: set[DroneKey] = set()
        self.orders: dict[int, Order] = {}
        self.answers: deque[dict[str, Any]] = deque(maxlen=MOST_ANSWERS)
        self.has_fogs = False
        self.has_rankings = False
        self.has_links = False
        self._has_begun = False
        self._entry = 0
        self._sent_ms = 0.0
        self._points: dict[ChartKey, int] = {}

    def take(self) -> dict[str, Any]:
        """Everything that has changed since the last call, with the time if an update is due; else empty."""
        live, update = self._live, dict[str, Any]()
        if not self._has_begun:
            self._has_begun = True
            update["hello"] = live.hello()
            self.drones = set(live.drones())
            self.orders = {order.number: order for order in live.orders()}
        if not self.has_fogs:
            self.has_fogs = True
            update["fogs"] = [fog_of(fog) for fog in live.fogs]
        if not self.has_rankings:
            self.has_rankings = True
            update["rankings"] = live.rankings()
        if not self.has_links:
            self.has_links = True
            update["links"] = live.shown_links
        sensors = live.history.readings_since(self._points)
        if sensors:
            update["sensors"] = sensors
        if self.drones:
            known = live.drones()
            update["drones"] = [drone_of(*known[key]) for key in sorted(self.drones) if key in known]
            self.drones = set()
        if self.orders:
            now_s = asyncio.get_running_loop().time()
            update["orders"] = [order.as_plain(now_s) for _, order in sorted(self.orders.items())]
            self.orders = {}
        entries = live.log.after(self._entry, MOST_ENTRIES)
        if entries:
            update["log"] = [{name: entry[name] for name in ("number", "time", "text", "code")} for entry in entries]
            self._entry = entries[-1]["number"]
        if self.answers:
            update["answers"] = list(self.answers)
            self.answers.clear()
        if update or now_ms() - self._sent_ms >= BEAT_MS:
            self._sent_ms = update["at_ms"] = now_ms()
        return update


class Live:
    """The state of one page.

    Parameters:
        station: an entered station, or several as one; where pages may command, one that wants control.
        fogs: the fogs that it is connected to.
        watch_only: no command that a page requests is carried out.
        links: links to show and change; None: none.
        tiles: the tiles that the map may request; None: none.
        places: places that the map shows and that are found by name.
    """

    def __init__(
        self,
        station: GroundStation | Fleets,
        fogs: list[Fog],
        watch_only: bool,
        links: Links | None = None,
        tiles: Offer | None = None,
        places: tuple[Place, ...] = (),
    ) -> None:
        self.fogs = fogs
        self.log = EventLog()
        self.history = History()
        self._station = station
        self._watch_only = watch_only
        self._tiles = tiles
        self._places = places
        self.shown_links: list[dict[str, Any]] = []
        self._links = links
        self._linking = asyncio.Lock()
        self._group: asyncio.TaskGroup | None = None
        self._desk: OrderDesk | None = None
        self._viewers: set[Viewer] = set()
        self._seen = self._standing()
        for _, drone in self.drones().values():
            for reading in drone.readings:
                self.history.on_reading(reading)

    async def run(self) -> None:
        """Run until the station has ended; raises BrokerRefused if the broker ended it."""
        try:
            async with asyncio.TaskGroup() as group:
                self._group = group
                if not self._watch_only:
                    self._desk = OrderDesk(self._station, self.fogs, self.log, group, self._on_order, self._places)
                reviewing = [group.create_task(self._review())]
                if self._links is not None:
                    reviewing.append(group.create_task(self._look(self._links)))
                async for event in self._station.events():
                    self._on_event(event)
                for task in reviewing:
                    task.cancel()
        except* MqttxtError as errors:
            raise errors.exceptions[0] from None
        finally:
            self._desk = self._group = None

    def enter(self) -> Viewer:
        """Add a browser, which is shown everything from now on."""
        viewer = Viewer(self)
        self._viewers.add(viewer)
        return viewer

    def leave(self, viewer: Viewer) -> None:
        """Remove a browser."""
        self._viewers.discard(viewer)

    def on_request(self, text: str) -> dict[str, Any]:
        """Carry out a page's request; returns the answer, with `error` if it was refused."""
        number: int | None = None
        try:
            number, request = read_request(text, now_ms())
            if isinstance(request, LookRequest):
                return {"number": number, "plan": _seen(request.plan)}
            if isinstance(request, LinkRequest):
                if self._links is None or self._group is None:
                    raise ConfigurationError(_NO_LINKS)
                self._group.create_task(self._change(self._links, request))
                return {"number": number}
            if self._desk is None:
                raise ConfigurationError(_ONLY_WATCHES if self._watch_only else _NOT_OPEN)
            return {"number": number, "order": self._desk.carry_out(request).number}
        except ConfigurationError as error:
            lines = _first(error.lines)
            self.log.add("Refused", printable("; ".join(lines)))
            return {"number": number, "error": "\n".join(lines)}

    def hello(self) -> dict[str, Any]:
        """The content that does not change."""
        stations = self._station.stations if isinstance(self._station, Fleets) else {"": self._station}
        return {
            "station": self._station.name,
            "names": {fleet: station.name for fleet, station in stations.items()},
            "prefixes": [station.prefix for station in stations.values()],
            "brokers": [station.broker for station in stations.values()],
            "fogs": [name_of(fog) for fog in self.fogs],
            "watch_only": self._watch_only,
            "commands": catalogue(),
            "ttl_s": TTL_S,
            "longest_ttl_s": LONGEST_TTL_S,
            "stale_ms": STALE_MS,
            "links": self._links.title if self._links is not None else None,
            "tiles": asdict(self._tiles) if self._tiles is not None else None,
            "places": [asdict(place) for place in self._places],
        }

    def drones(self) -> dict[DroneKey, tuple[Fog, Drone]]:
        """Every drone known to a fog, with that fog."""
        return {(fog.fleet, fog.number, drone.number): (fog, drone) for fog in self.fogs for drone in fog.drones}

    def rankings(self) -> dict[str, Any]:
        """QoDS's order of each fog, and PSMI's newest lists."""
        return {
            "fogs": [{"fog": name_of(fog), "ranking": as_plain(fog.ranking)} for fog in self.fogs],
            "lists": [_shown(found) for found in self.history.lists],
        }

    def orders(self) -> list[Order]:
        """The commands that were sent, oldest first."""
        return list(self._desk.orders) if self._desk is not None else []

    def _on_event(self, event: Event) -> None:
        self.log.on_event(event)
        self.history.on_event(event)
        if self._desk is not None:
            self._desk.on_event(event)
        if isinstance(event, StateUpdate | Reachability | ControlChanged):
            for viewer in self._viewers:
                viewer.drones.add((event.fleet, event.fog, event.drone))
        elif isinstance(event, QodsRanking | PsmiList):
            for viewer in self._viewers:
                viewer.has_rankings = False

    def _on_order(self, order: Order) -> None:
        for viewer in self._viewers:
            viewer.orders[order.number] = order

    async def _look(self, links: Links) -> None:
        """Read the links every LOOK_S, in a thread, because reading their traffic takes time."""
        while True:
            async with self._linking:
                self.shown_links = [asdict(figures) for figures in await asyncio.to_thread(links.look)]
            for viewer in self._viewers:
                viewer.has_links = False
            await asyncio.sleep(LOOK_S)

    async def _change(self, links: Links, wanted: LinkRequest) -> None:
        """Change a link; if that fails, every browser gets the reason."""
        figures = [f"{name} {text}" for name, text in wanted.figures.items()] + ["closed" if wanted.closed else "open"]
        said = f"link {printable(wanted.name)}: {printable('as planned' if wanted.back else ', '.join(figures))}"
        try:
            async with self._linking:
                if wanted.back:
                    await asyncio.to_thread(links.put_back, wanted.name)
                else:
                    await asyncio.to_thread(links.change, wanted.name, wanted.figures, wanted.closed)
        except ConfigurationError as error:
            said = printable(str(error))
            for viewer in self._viewers:
                viewer.answers.append({"number": None, "error": said})
        self.log.add("Link", said)

    async def _review(self) -> None:
        """Look for changes that have no event: a fog whose beacons stopped, and its drones with it."""
        while True:
            await asyncio.sleep(REVIEW_S)
            fogs, standings = self._seen
            now_fogs, now = self._standing()
            changed = {key for key, standing in now.items() if standings.get(key) != standing}
            for viewer in self._viewers:
                viewer.drones |= changed
                viewer.has_fogs &= now_fogs == fogs
            for before, fog in zip(fogs, now_fogs, strict=True):
                if before["live"] != fog["live"]:
                    self.log.add("Fog", f"fog {fog['fog']}: {'heard again' if fog['live'] else 'not heard any more'}")
            self._seen = now_fogs, now

    def _standing(self) -> tuple[list[dict[str, Any]], dict[DroneKey, tuple[bool, str | None, bool]]]:
        drones = self.drones()
        return [fog_of(fog) for fog in self.fogs], {key: standing_of(drone) for key, (_, drone) in drones.items()}


def now_ms() -> float:
    """The time, in ms, that updates give to pages, and pages to their requests; it never goes back."""
    return asyncio.get_running_loop().time() * 1000


def _seen(plan: Plan) -> dict[str, Any]:
    """What a page shows of a plan file, with the editor's draft of it or the reason why there is none."""
    draft = draft_of(plan)
    return {
        "text": str(plan),
        "path": path_of(plan),
        "draft": asdict(draft) if isinstance(draft, Draft) else None,
        "why": draft if isinstance(draft, str) else None,
    }


def _shown(found: PsmiList) -> dict[str, Any]:
    """A choice, with the reason in plain English for each drone that was left out."""
    left_out = [as_plain(one) | {"plain": why_left_out(one)} for one in found.left_out]
    shown: dict[str, Any] = as_plain(found)
    return shown | {"left_out": left_out}


def _first(lines: tuple[str, ...]) -> list[str]:
    """The first lines, and the number of further ones."""
    more = len(lines) - MOST_LINES
    return [*lines[:MOST_LINES], *([f"and {more} more"] if more > 0 else [])]
