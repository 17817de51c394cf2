"""The documents' pictures, made from the code and from the fleet: `python -m spec.pictures FOLDER…`.

A test checks that the pictures in docs/pictures are up to date.
"""

from __future__ import annotations

import io
import json
import re
import sys
from collections.abc import Callable
from itertools import pairwise, product
from statistics import mean

from rich.console import Console

from mqttxt.core.clock import BEACON_INTERVAL_MS, DEFAULT_TTL_MS
from mqttxt.core.settings import GRACE_MS
from mqttxt.drone.command_writer import RESEND_MS, SENDS
from mqttxt.protocol.commands import Takeoff
from mqttxt.protocol.topics import CloudSide, FogSide
from testbed.fly.results import METRICS, REPORT
from testbed.plan.compose import read_services
from testbed.plan.documents import ROOT
from testbed.plan.fleets import standard_fleet
from testbed.plan.wording import PROTOCOL_NAMES
from testbed.present.report import sentences
from testbed.present.report import terminal as report_terminal
from testbed.present.summary.page import PAGE

from . import flights, load_picture
from .pages import folders
from .svg import Drawing

_MISSION = {"mqttxt": "mission (mqttxt)", "mavlink": "mission (MAVSDK)"}
"""The programs that the runner starts on the ground station; compose.yaml has those of all other nodes."""
_NAMES = {"sitl fly": "sitl (autopilot)", "router": "mavp2p", "mosquitto": "Mosquitto"}
SHOWN = "five-states-bundled-lte"
_COLUMNS = {"gs": 100, "cloud": 325, "fog": 560, "uav": 795}
_WIDTH, _ROW, _TALL = 150, 52, 40


def topology() -> Drawing:
    """Draw the nodes with their addresses, the links between them, and the programs on each kind of node."""
    fleet = standard_fleet()
    nodes = fleet.topology()
    rows = {f"uav{drone}": row for row, drone in enumerate(fleet.fog_of)}
    height = 40 + _ROW * len(rows)
    places: dict[str, tuple[float, float]] = {name: (_COLUMNS["uav"], 20 + _ROW * row) for name, row in rows.items()}
    for fog, drones in fleet.fogs.items():
        places[f"fog{fog}"] = (_COLUMNS["fog"], mean(places[f"uav{drone}"][1] for drone in drones))
    between = mean(places[f"fog{fog}"][1] for fog in fleet.fogs)
    places |= {name: (_COLUMNS[name], between) for name in ("gs", "cloud")}
    drawing = Drawing(980, height + 92, "The testbed's nodes and links")
    for link in nodes.links:
        left, right = sorted([places[link.upper], places[link.lower]])
        start, end = (left[0] + _WIDTH, left[1] + _TALL / 2), (right[0], right[1] + _TALL / 2)
        drawing.line(start, end)
        kind, middle = link.name.partition(":")[0], ((start[0] + end[0]) / 2, (start[1] + end[1]) / 2)
        drawing.box(middle[0] - 4 * len(kind), middle[1] - 9, 8 * len(kind), 18, "paper")
        drawing.text(middle[0], middle[1] + 4, kind, "small", "middle")
    for node in nodes.nodes:
        x, y = places[node.name]
        drawing.box(x, y, _WIDTH, _TALL)
        drawing.text(x + _WIDTH / 2, y + 17, node.name, "title", "middle")
        drawing.text(x + _WIDTH / 2, y + 33, node.address, "code", "middle")
    for row, (protocol, name) in enumerate(PROTOCOL_NAMES.items()):
        y = height + 22 + 20 * row
        drawing.text(20, y, name, f"title {protocol}")
        for kind, x in _COLUMNS.items():
            drawing.text(x, y, ", ".join(programs(kind, protocol)), protocol)
    text = "Every link goes through the container net, which routes, shapes and captures."
    drawing.text(20, height + 72, text, "small")
    return drawing


def programs(kind: str, protocol: str) -> list[str]:
    """The programs on nodes of a kind (gs, cloud, fog, uav) during a flight over `protocol`."""
    found = [_MISSION[protocol]] if kind == "gs" else []
    for service in read_services().values():
        node = service.get("network_mode", "").removeprefix("service:")
        if node.rstrip("0123456789") == kind and protocol in service["profiles"]:
            found.append(_program(service["command"]))
    return list(dict.fromkeys(found))


def _program(command: str | list[str]) -> str:
    words = command.split() if isinstance(command, str) else command
    name = " ".join(words[: next(index for index, word in enumerate(words) if word.startswith("-"))])
    return _NAMES.get(name, name)


_READ = ("fleet.yaml", "tc_profiles/NAME.yaml", "my_mission.py")
_ROOMS = (
    ("plan", "resolves experiment, factors and profile", ("experiment, factors, links and their events",)),
    (
        "fly",
        "starts the nodes, probes the links, flies, captures",
        ("manifest.json", "events.jsonl", "sitl/", "pcap/", "links/", "logs/"),
    ),
    (
        "numbers",
        "dissects the captures, computes each quantity once",
        ("packets.parquet", "messages.parquet", METRICS),
    ),
    ("present", "shows the quantities, computes nothing", (REPORT, "figures/", PAGE, "compare.html")),
)
"""The rooms of `testbed`, the work of each, and its output."""


def data_flow() -> Drawing:
    """Draw the way from hand-written files to the report: each room of `testbed` reads the output of the one above."""
    step = 84
    drawing = Drawing(860, 70 + step * len(_ROOMS), "From a plan to a report")
    drawing.box(410, 20, 430, 40)
    drawing.text(426, 45, "   ".join(_READ), "code")
    below = 60
    for index, (room, what, made) in enumerate(_ROOMS):
        y = 86 + step * index
        drawing.line((600, below), (200, y), arrow=True)
        drawing.box(20, y, 350, 56, "room")
        drawing.text(36, y + 24, f"testbed.{room}", "title")
        drawing.text(36, y + 44, what, "small")
        drawing.line((370, y + 28), (410, y + 28), arrow=True)
        drawing.box(410, y, 430, 56)
        drawing.text(426, y + 33, "   ".join(made), "code")
        below = y + 56
    return drawing


_LIVES = ("ground station", "cloud broker", "activator", "fog broker", "UAV client", "autopilot")
_APART = 150


def command() -> Drawing:
    """Draw the way of one takeoff, from the call to its last word, with its deadlines."""
    fog, field = CloudSide(1), FogSide()
    name, limit_s, grace_s = Takeoff.name, Takeoff.limit_s, GRACE_MS / 1000
    drawing = Drawing(900, 652, "A command's way and its deadlines")
    at = {life: 75 + _APART * index for index, life in enumerate(_LIVES)}
    for life, x in at.items():
        drawing.box(x - 60, 14, 120, 28)
        drawing.text(x, 33, life, "title", "middle")
        drawing.line((x, 42), (x, 556), dashed=True)
    station, cloud, activator, broker, drone, autopilot = at.values()

    def sends(y: float, hops: tuple[float, ...], label: str) -> None:
        for start, end in pairwise(hops):
            drawing.line((start, y), (end, y), arrow=True)
        drawing.text((hops[0] + hops[-1]) / 2, y - 6, label, "code halo", "middle")

    def decides(x: float, y: float, *words: str) -> None:
        drawing.box(x - 112, y, 224, 18 + 15 * len(words), "room")
        for index, line in enumerate(words):
            drawing.text(x, y + 20 + 15 * index, line, "small", "middle")

    beacon = f"{BEACON_INTERVAL_MS // 1000} s"
    sends(72, (activator, cloud, station), f"{fog.clock}: beacon, every {beacon}")
    sends(72, (drone, broker, activator), f"{field.clock(1)}: beacon, every {beacon}")
    decides(station + 42, 88, "D = the activator's clock", f"at the call + ttl ({DEFAULT_TTL_MS / 1000:g} s)")
    sends(162, (station, cloud, activator), f"{fog.drone_commands(1)}, with D")
    decides(activator, 178, "clock ≥ D: expired", "D′ = the drone's clock + what is left")
    sends(252, (activator, broker, drone), f"{field.commands(1)}, with D′")
    decides(drone, 268, "clock ≤ D′ before every write", "past D′ before the first: expired")
    sends(342, (drone, autopilot), "NAV_TAKEOFF")
    repeats = f"up to {SENDS} times, every {RESEND_MS / 1000:g} s"
    drawing.text((drone + autopilot) / 2, 358, repeats, "small halo", "middle")
    sends(388, (autopilot, drone), "COMMAND_ACK")
    for y, word in ((412, "accepted"), (486, "completed")):
        sends(y, (drone, broker, activator), field.commands_result(1, name))
        sends(y, (activator, cloud, station), fog.drone_result(1, name))
        for x in (broker, cloud):
            drawing.text(x, y + 18, word, "title halo", "middle")
    sends(462, (autopilot, drone), "telemetry: at the height")
    decides(activator, 514, "no last word: unconfirmed", f"{grace_s:g} s after D + limit")
    decides(station + 42, 514, "no last word: unconfirmed", f"{2 * grace_s:g} s after ttl + limit")
    decides(drone, 514, f"limit ({limit_s:g} s for {name})", "is over: failed(timeout)")
    rules = (
        "ttl bounds the start: no write to the autopilot happens once the UAV client's clock is past D′.",
        "limit bounds the end: it runs from the start at the UAV client.",
        "Beacons give the other clock's least reading: a delayed beacon makes a deadline earlier, never later.",
    )
    for index, rule in enumerate(rules):
        drawing.text(20, 592 + 22 * index, rule)
    return drawing


def terminal() -> str:
    """A run's last lines on the terminal, as SVG, from the newest kept series of scenario 1 with SHOWN's conditions."""
    series = max((ROOT / "docs" / "findings" / "scenario-1" / SHOWN).iterdir())
    metrics = json.loads((series / METRICS).read_text(encoding="utf-8"))
    console = Console(record=True, width=106, file=io.StringIO(), force_terminal=True, highlight=False)
    console.print(f"$ make scenario-1 ARM={metrics['arm']} PROFILE={metrics['profile']} ATTEMPTS=3", style="bold")
    console.print("…\n")
    console.print(f"{sentences.finding(metrics)} {sentences.basis(metrics)}", markup=False)
    for table in (report_terminal.comparison_table(metrics), report_terminal.attempts_table(metrics)):
        console.print(table)
    drawn = console.export_svg(title="make scenario-1", unique_id="terminal")
    return re.sub(r"@font-face {.*?}\s*", "", drawn, flags=re.DOTALL)  # without fonts from other hosts


PICTURES: dict[str, Callable[[], str]] = {
    "topology": lambda: topology().svg(),
    "data-flow": lambda: data_flow().svg(),
    "command": lambda: command().svg(),
    "load": lambda: load_picture.draw().svg(),
    "flights": lambda: flights.draw(flights.read_flights()).svg(),
    "terminal": terminal,
}


def main(*directories: str) -> None:
    """Write every picture into `directories`."""
    for folder, (name, draw) in product(folders(directories), PICTURES.items()):
        (folder / f"{name}.svg").write_text(draw(), encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
