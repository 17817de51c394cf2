"""The links of a run, looked after: the start, changes by hand and by range, and what is written of it all."""

from __future__ import annotations

import json
import os
import socket
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from net.interfaces import NetError
from net.shaping.attend import START_EVERY_S, Attendant
from net.shaping.choice import choose
from net.shaping.run_plan import read_run_plan
from net.shaping.server import ask
from testbed.plan.fleets import standard_fleet
from testbed.plan.profiles import run_plan as host
from testbed.plan.profiles.reading import read_profile
from testbed.plan.profiles.resolve import resolve

TOPOLOGY = standard_fleet().topology()
UP, DOWN = "air:uav1:up", "air:uav1:down"
GATE = host.Gate("air:uav1", 1, 47.0, 8.0)


class FakeLinks:
    """Remembers what it was told."""

    checked: Mapping[str, Any] = {"queues": 18}
    socket = None

    def __init__(self) -> None:
        self.told: list[tuple[Any, ...]] = []

    def start(self, at_ns: int) -> None:
        self.told.append(("start", at_ns))

    def hold(self, link: str, change: Mapping[str, Any] | None, words: Any) -> int:
        self.told.append(("hold", link, change, words))
        return 5

    def shut(self, link: str, shut: bool) -> int:
        self.told.append(("shut", link, shut))
        return 6

    def attend(self) -> float | None:
        return None

    def end(self) -> None:
        self.told.append(("end",))


class Bench:
    """A run's folder with a plan, looked after."""

    def __init__(self, run_dir: Path, profile: str = "lan", **options: Any) -> None:
        self.folder = run_dir / "links"
        self.folder.mkdir()
        self.links = FakeLinks()
        plan = resolve(read_profile(profile), TOPOLOGY, "scenario-1", 1, 60)
        (self.folder / "plan.json").write_text(json.dumps(host.run_plan(plan, TOPOLOGY, shaper="nfqueue", **options)))
        self.run = read_run_plan(self.folder / "plan.json")

    def attend(self) -> Attendant:
        choice = choose(self.run)
        return Attendant(self.folder, self.run, choice, lambda _: None if choice.shaper == "none" else self.links)

    def events(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in (self.folder / "events.jsonl").read_text().splitlines()]

    def fly(self, latitude_deg: float) -> None:
        path = self.folder.parent / "sitl" / "uav1.position.json"
        path.parent.mkdir(exist_ok=True)
        path.write_text(json.dumps({"latitude_deg": latitude_deg, "longitude_deg": 8.0}))


def test_the_start_is_when_its_file_was_made(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    attendant = bench.attend()
    assert attendant.attend() == START_EVERY_S
    (bench.folder / "start").touch()
    made_ns = (bench.folder / "start").stat().st_mtime_ns
    assert attendant.attend() > START_EVERY_S
    attendant.attend()
    assert bench.links.told == [("start", made_ns)], "once"
    assert bench.events() == [{"t_ns": made_ns, "event": "start"}]


def test_a_start_file_with_an_odd_time_counts_from_when_it_was_seen(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    attendant = bench.attend()
    (bench.folder / "start").touch()
    os.utime(bench.folder / "start", (1.0, 1.0))
    before_ns = time.time_ns()
    attendant.attend()
    ((_, at_ns),) = bench.links.told
    assert at_ns >= before_ns


def test_a_folder_that_was_used_before_is_refused(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    (bench.folder / "start").touch()
    with pytest.raises(NetError, match="start: is there before the mission; expected a folder of a fresh attempt"):
        bench.attend()


def test_what_shapes_is_written_down(tmp_path: Path) -> None:
    Bench(tmp_path).attend()
    said = json.loads((tmp_path / "links" / "shaper.json").read_text())
    assert (said["shaper"], said["why"], said["checked"]) == ("nfqueue", "the plan asks for it", {"queues": 18})
    assert said["kernel"] == os.uname().release


def test_a_plan_of_nothing_counts_nothing(tmp_path: Path) -> None:
    bench = Bench(tmp_path, "ideal")
    attendant = bench.attend()
    counted = json.loads((bench.folder / "counters.json").read_text())
    assert (counted["shaper"], counted["links"], counted["void"]) == ("none", {}, None)
    (bench.folder / "start").touch()
    attendant.attend()
    attendant.end()
    assert bench.links.told == []
    assert [event["event"] for event in bench.events()] == ["start"]


def test_a_gate_is_shut_first_and_follows_the_drone(tmp_path: Path) -> None:
    bench = Bench(tmp_path, "ideal", gates=[GATE])
    attendant = bench.attend()
    assert bench.links.told == [("shut", UP, True), ("shut", DOWN, True)]
    bench.fly(47.0001)
    attendant.attend()
    attendant.attend()
    assert bench.links.told[2:] == [("shut", UP, False), ("shut", DOWN, False)]
    bench.fly(47.1)
    attendant.attend()
    changed = [(event["link"], event["change"], event["cause"]) for event in bench.events()]
    closed = {"closed": True}
    assert changed == [
        *((UP, closed, "range"), (DOWN, closed, "range")),
        *((UP, None, "range"), (DOWN, None, "range")),
        *((UP, closed, "range"), (DOWN, closed, "range")),
    ]


def _asked(attendant: Attendant, path: Path, request: Any) -> dict[str, Any]:
    (serve,) = attendant.serve(path).values()
    thread = threading.Thread(target=serve)
    thread.start()
    try:
        return ask(path, request)
    finally:
        thread.join()


def test_a_change_by_hand_is_answered_and_written_down(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    request = {"link": UP, "change": {"loss": 0.2}, "kernel": [["tc", "qdisc"]]}
    assert _asked(bench.attend(), tmp_path / "s", request) == {"ok": True}
    assert bench.links.told == [("hold", UP, {"loss": 0.2}, [["tc", "qdisc"]])]
    assert bench.events() == [{"t_ns": 5, "link": UP, "change": {"loss": 0.2}, "cause": "hand"}]


@pytest.mark.parametrize(
    ("request_", "said"),
    [
        ([], "[]: expected an object with link, change and"),
        ({"link": UP, "change": None, "speed": 1}, "expected an object with link, change and"),
        ({"link": ["x"], "change": None}, "link ['x']: expected one of wan:gs:up, "),
        ({"link": UP, "change": {"loss": -1}}, f"{UP}.change.loss -1: expected a share from 0 to 1"),
        ({"link": UP, "change": {}}, f"{UP}.change {{}}: expected at least one field of a link"),
        (
            {"link": UP, "change": None, "kernel": [["rm"]]},
            f"{UP}: kernel: [['rm']]: expected a list of lists of words",
        ),
    ],
)
def test_a_request_that_makes_no_sense_is_answered_in_one_line(tmp_path: Path, request_: Any, said: str) -> None:
    bench = Bench(tmp_path)
    assert said in _asked(bench.attend(), tmp_path / "s", request_)["error"]
    assert bench.links.told == []
    assert bench.events() == []


def test_who_says_nothing_or_nonsense_does_no_harm(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    path = tmp_path / "s"
    (serve,) = bench.attend().serve(path).values()
    for said in (b"{\n", b""):
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
            connection.connect(str(path))
            connection.sendall(said)
            connection.shutdown(socket.SHUT_WR)
            serve()
            assert json.loads(connection.recv(200)) == {"error": f"{said.decode().strip()!r}: expected a line of JSON"}


def test_without_net_route_there_is_nobody_to_ask(tmp_path: Path) -> None:
    with pytest.raises(NetError, match="expected `net route --links` to run here"):
        ask(tmp_path / "s", {})
