"""The live table of `mqttxt gs watch`."""

from __future__ import annotations

import asyncio
import contextlib
from datetime import UTC, datetime

from rich.console import Console, Group
from rich.live import Live
from rich.markup import escape
from rich.table import Table

from ..core.printable import printable
from ..protocol.names import MAX_DRONE, in_fleet
from ..protocol.states import Armed, Battery, FlightMode, Groundspeed, Heading, Health, LandedState
from ..station.fleets import Fleets
from ..station.ground_station import GroundStation
from ..station.heard import EventStream
from ..station.views import Drone, Fog

REFRESH_S = 0.5
FIRST_STATES_S = 5.0
SHOWN = frozenset({"armed", "battery", "flight_mode", "heading", "landed_state", "location"})


async def watch_fogs(station: GroundStation | Fleets, fogs: list[Fog], console: Console) -> None:
    """Draw the table twice per second until the station ends; without a terminal, print it once."""
    if not console.is_terminal:
        known = [drone for fog in fogs for drone in fog.drones]
        with contextlib.suppress(TimeoutError):
            await station.wait_until(
                lambda: (
                    all(set(d.states) >= SHOWN for d in known if d.is_reachable)
                    and all(len(fog.ranking) >= sum(d.is_reachable for d in fog.drones) for fog in fogs)
                ),
                timeout_s=FIRST_STATES_S,
            )
        wide = Console(width=180, file=console.file)
        wide.print(everything(fogs))
        return
    ended = asyncio.create_task(_end_of(station.events()))
    try:
        with Live(everything(fogs), console=console, auto_refresh=False) as live:
            while not ended.done():
                await asyncio.wait({ended}, timeout=REFRESH_S)
                live.update(everything(fogs), refresh=True)
        await ended
    finally:
        ended.cancel()


async def _end_of(events: EventStream) -> None:
    """Wait until a station's events end; raises the error that ended it."""
    async for _ in events:
        pass


def everything(fogs: list[Fog]) -> Group:
    """The drones and, if there are any, the sensors' newest readings."""
    found = readings(fogs)
    return Group(table(fogs), found) if found.rows else Group(table(fogs))


def readings(fogs: list[Fog]) -> Table:
    """The newest reading of each sensor and kind, with the time at which it was measured."""
    shown = Table(title="Sensors", title_justify="left")
    for heading in ("drone", "sensor", "kind"):
        shown.add_column(heading)
    for heading in ("value", "measured (UTC)"):
        shown.add_column(heading, justify="right")
    for reading in (reading for fog in fogs for drone in fog.drones for reading in drone.readings):
        value = _shown(f"{reading.value:g} {reading.unit}".strip())
        shown.add_row(
            in_fleet(reading.fleet, reading.drone), str(reading.sensor), reading.kind, value, _time_of(reading.time_ms)
        )
    return shown


def _shown(text: str) -> str:
    """A received text without effect: neither markup nor anything that a terminal obeys."""
    return escape(printable(text))


def _time_of(unix_ms: int) -> str:
    """A wall clock's time; one outside the calendar is shown as the number that arrived."""
    try:
        return f"{datetime.fromtimestamp(unix_ms / 1000, UTC):%Y-%m-%d %H:%M:%S}"
    except (OverflowError, ValueError, OSError):
        return f"{unix_ms} ms"


def table(fogs: list[Fog]) -> Table:
    """Fogs and drones, one row per drone, best first by QoDS; the age of the newest state is an upper bound."""
    shown = Table(title="MQTT-XT", title_justify="left")
    for heading in ("fog", "QoDS", "drone", "reachable", "control", "armed", "mode", "landed"):
        shown.add_column(heading)
    for heading in ("position", "altitude m", "speed m/s", "heading", "battery", "heard s ago"):
        shown.add_column(heading, justify="right")
    for fog in fogs:
        name = in_fleet(fog.fleet, fog.number)
        name = name if fog.is_live else f"{name} [red]gone[/]"
        places = {ranked.drone: str(place) for place, ranked in enumerate(fog.ranking, start=1)}
        for drone in sorted(fog.drones, key=lambda drone: (int(places.get(drone.number, MAX_DRONE)), drone.number)):
            shown.add_row(name, places.get(drone.number, "-"), *_cells(drone))
        if not fog.drones:
            shown.add_row(name, "-", "[dim]none[/]")
    return shown


def _cells(drone: Drone) -> list[str]:
    mode, landed = drone.state(FlightMode), drone.state(LandedState)
    place, speed = drone.location, drone.state(Groundspeed)
    heading, battery = drone.state(Heading), drone.state(Battery)
    return [
        str(drone),
        "[green]yes[/]" if drone.is_reachable else "[red]no[/]",
        _shown(drone.holder or "-"),
        _armed(drone),
        mode.state.mode.label if mode else "-",
        landed.state.landed.label.replace("_", " ") if landed else "-",
        f"{_fixed(place.state.latitude_deg, 5)} {_fixed(place.state.longitude_deg, 5)}" if place else "-",
        _fixed(place.state.altitude_m, 1) if place else "-",
        f"{speed.state.groundspeed_m_s:.1f}" if speed else "-",
        f"{round(heading.state.heading_deg) % 360}" if heading else "-",
        f"{battery.state.remaining_pct} %" if battery else "-",
        _age(drone),
    ]


def _fixed(value: float, digits: int) -> str:
    """A number with `digits` decimals; one that rounds to zero has no sign."""
    return f"{round(value, digits) + 0.0:.{digits}f}"


def _armed(drone: Drone) -> str:
    armed, health = drone.state(Armed), drone.state(Health)
    if armed is None:
        return "-"
    if armed.state.armed:
        return "[yellow]armed[/]"
    return "no ([red]not armable[/])" if health is not None and not health.state.armable else "no"


def _age(drone: Drone) -> str:
    """An upper bound of the newest state's age, in seconds."""
    ages = [known.age_ms for known in drone.states.values() if known.age_ms is not None]
    return f"{min(ages) / 1000:.1f}" if ages else "-"
