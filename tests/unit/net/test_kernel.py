"""netem by commands: what a plan asks for is carried out, read back, changed at its times and counted."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from net.emulator.plan import PlanError
from net.interfaces import Cable, NetError, Port
from net.link_plan import EventPlan, LinkPlan
from net.shaping.choice import choose, try_netem
from net.shaping.commands import Done, carry_out
from net.shaping.journal import Journal
from net.shaping.kernel import KernelLinks
from net.shaping.run_plan import read_run_plan
from testbed.plan.fleets import standard_fleet
from testbed.plan.profiles import run_plan as host
from testbed.plan.profiles.kernel import change_words
from testbed.plan.profiles.reading import profile_names, read_profile
from testbed.plan.profiles.resolve import LinksPlan, resolve
from tests.unit.net.fake_tc import FakeTc

TOPOLOGY = standard_fleet().topology()
PORTS = [Port(node.name, Cable("", node.address), f"eth{number}", "") for number, node in enumerate(TOPOLOGY.nodes)]
UP = "air:uav1:up"
DEVICE = "air-uav1-up"
S = 1_000_000_000


class Bench:
    """A plan's links by a fake kernel; the clock is moved by hand."""

    def __init__(
        self, folder: Path, plan: LinksPlan, monkeypatch: pytest.MonkeyPatch, tc: FakeTc | None = None, **options: Any
    ):
        self.folder, self.plan, self.now_s = folder, plan, 1000.0
        monkeypatch.setattr(time, "monotonic", lambda: self.now_s)
        monkeypatch.setattr(time, "time_ns", lambda: int(self.now_s * S))
        (folder / "plan.json").write_text(json.dumps(host.run_plan(plan, TOPOLOGY, **options)))
        self.run = read_run_plan(folder / "plan.json")
        self.tc = tc or FakeTc()
        self.links = KernelLinks(folder, self.run, PORTS, Journal(folder / "events.jsonl"), self.tc)

    def at(self, seconds: float) -> list[str]:
        """What the kernel is told by then, with the start at 0."""
        self.now_s, told = 1000.0 + seconds, len(self.tc.said)
        self.links.attend()
        return self.tc.said[told:]

    def counters(self) -> dict[str, int]:
        found: dict[str, int] = json.loads((self.folder / "counters.json").read_text())["links"][UP]
        return found

    def events(self) -> list[tuple[float, str, Any, str]]:
        lines = (self.folder / "events.jsonl").read_text().splitlines()
        found = [json.loads(line) for line in lines]
        return [(each["t_ns"] / S - 1000, each["link"], each["change"], each["cause"]) for each in found]

    def hold(self, change: Mapping[str, Any]) -> None:
        figures = replace(self.plan.links[UP], **{key: value for key, value in change.items() if key != "closed"})
        words = change_words(self.plan, TOPOLOGY, UP, figures, bool(change.get("closed")))
        self.links.hold(UP, change, words)


Made = Callable[..., Bench]


@pytest.fixture
def made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Made:
    """Makes the bench of a plan."""
    return lambda plan, **options: Bench(tmp_path, plan, monkeypatch, **options)


def plan_of(*events: EventPlan, **figures: Any) -> LinksPlan:
    plain = resolve(read_profile("ideal"), TOPOLOGY, "scenario-1", 1, 60)
    return replace(plain, links={**plain.links, UP: LinkPlan(**figures)}, events=events)


@pytest.mark.parametrize("name", profile_names())
def test_every_profile_is_read_back_as_it_was_asked_for(name: str, made: Made) -> None:
    plan = resolve(read_profile(name), TOPOLOGY, "scenario-1", 1, 60)
    bench = made(plan, always=True)
    assert bench.links.checked == {"qdiscs": 10 + 1 + 2 * 18, "classes": bench.links.checked["classes"], "filters": 108}
    assert bench.links.checked["classes"] == (24 if name == "sik" else 18)
    assert not [line for line in bench.tc.said if "@" in line]


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("limit", 1000, "limit 1000.0; expected 11000.0"),
        ("delay", {"delay": 0.05, "jitter": 0}, "delay 0.05; expected 0.1"),
        ("loss-random", {"loss": 0.02}, "loss 0.02; expected 0.01"),
        ("duplicate", {"duplicate": 0.01}, "duplicate 0.01; expected 0.0"),
        ("seed", 5, "seed 5.0; expected "),
    ],
)
def test_what_is_read_back_otherwise_is_named(field: str, value: object, said: str, made: Made) -> None:
    class Other(FakeTc):
        def _qdisc(self, words: list[str]) -> None:
            super()._qdisc(words)
            if DEVICE in words:
                self.qdiscs[DEVICE, "1:"]["options"][field] = value

    with pytest.raises(NetError) as error:
        made(plan_of(delay_us=100_000, loss=0.01), tc=Other())
    assert f"qdisc {DEVICE} 1:: {said}" in str(error.value)


def test_what_is_not_there_is_named(monkeypatch: pytest.MonkeyPatch, made: Made) -> None:
    monkeypatch.setattr(FakeTc, "_filter", lambda *_: None)
    with pytest.raises(NetError, match=r"filter eth4 ingress c6120003: not there; expected it as asked"):
        made(plan_of(delay_us=100_000))


def test_events_wait_for_the_start_and_are_carried_out_at_their_times(made: Made) -> None:
    outage = EventPlan(2.0, UP, 1.0, {"closed": True})
    bench = made(plan_of(outage, delay_us=100_000))
    assert bench.at(50.0) == []
    bench.links.start(int(1050.0 * S))
    assert bench.at(51.999) == []
    (closing,) = bench.at(52.0)
    assert closing.startswith(f"tc qdisc change dev {DEVICE} root handle 1: netem limit 11000 delay 100000us loss 100%")
    assert bench.links.attend() == pytest.approx(1.0, abs=0.01)
    (opening,) = bench.at(53.0)
    assert "loss" not in opening
    assert bench.events() == [(52.0, UP, {"closed": True}, "profile"), (53.0, UP, None, "profile")]


def test_an_event_leaves_the_stage_alone_that_it_does_not_change(made: Made) -> None:
    slower = EventPlan(1.0, UP, 1.0, {"rate_bps": 500_000})
    bench = made(plan_of(slower, rate_bps=1_000_000, queue_packets=9, loss=0.1))
    bench.links.start(1000 * S)
    changed = bench.at(1.0)
    assert [" ".join(line.split()[:5]) for line in changed] == [
        "tc class change dev rate",
        "tc qdisc change dev rate",
        f"tc qdisc change dev {DEVICE}",
    ]
    bench.hold({"loss": 0.5})
    assert [line.split()[4] for line in bench.tc.said[-3:]] == ["rate", "rate", DEVICE]
    told = len(bench.tc.said)
    bench.hold({"loss": 0.6})
    assert [line.split()[4] for line in bench.tc.said[told:]] == [DEVICE]


def test_what_a_closed_link_dropped_is_told_from_what_was_drawn(tmp_path: Path, made: Made) -> None:
    outage = EventPlan(2.0, UP, 1.0, {"closed": True})
    bench = made(plan_of(outage, rate_bps=1_000_000, queue_packets=9, loss=0.1))
    bench.tc.count(DEVICE, packets=7, drops=1)
    bench.links.start(1000 * S)
    bench.tc.count(DEVICE, packets=90, drops=10)
    bench.at(2.0)
    bench.tc.count(DEVICE, packets=90, drops=35)
    bench.at(3.0)
    bench.tc.count(DEVICE, packets=180, drops=46, qlen=2)
    bench.tc.count("rate", "207:", packets=228, drops=5, qlen=3)
    bench.tc.pass_by("eth2", "0x7", 228)
    bench.at(4.0)
    counted = bench.counters()
    assert (counted["random"], counted["closed"], counted["queue"], counted["left"]) == (21, 25, 5, 180)
    assert (counted["entered"], counted["duplicated"], counted["overload"]) == (236, 0, 0)
    at_start = json.loads((tmp_path / "counters.json").read_text())["at_start"][UP]
    assert (at_start["left"], at_start["random"], at_start["closed"]) == (7, 1, 0)


def test_without_a_rate_what_enters_is_what_comes_to_the_delay(made: Made) -> None:
    bench = made(plan_of(delay_us=1000, duplicate=0.1))
    bench.tc.count(DEVICE, packets=110)
    bench.tc.pass_by("eth2", "0x7", 100)
    bench.at(2.0)
    assert (bench.counters()["entered"], bench.counters()["duplicated"]) == (100, 10)


def test_frames_that_the_kernel_dropped_before_a_link_void_the_run(tmp_path: Path, made: Made) -> None:
    bench = made(plan_of(delay_us=1000))
    bench.at(2.0)
    assert json.loads((tmp_path / "counters.json").read_text())["void"] is None
    bench.tc.devices[DEVICE] = 3
    bench.at(4.0)
    void = json.loads((tmp_path / "counters.json").read_text())["void"]
    assert void == f"the kernel dropped frames before the links: {{'{DEVICE}': 3}}"


def test_a_change_by_hand_hides_events_until_it_is_let_go(made: Made) -> None:
    later = EventPlan(1.0, UP, 5.0, {"loss": 0.9})
    bench = made(plan_of(later, delay_us=1000), always=True)
    bench.links.start(1000 * S)
    bench.hold({"loss": 0.2})
    assert "loss 20%" in bench.tc.said[-1]
    assert bench.at(1.0) == []
    bench.links.hold(UP, None, [])
    assert "loss 90%" in bench.tc.said[-1]
    assert bench.events() == [(1.0, UP, {"loss": 0.9}, "profile")]
    assert len(bench.at(6.0)) == 1


def test_a_link_that_is_shut_stays_so_whatever_it_is_told(made: Made) -> None:
    gate = host.Gate("air:uav1", 1, 47.4, 8.5)
    bench = made(plan_of(EventPlan(1.0, UP, 1.0, {"loss": 0.5})), gates=[gate])
    bench.links.start(1000 * S)
    bench.links.shut(UP, True)
    assert "loss 100%" in bench.tc.said[-1]
    assert bench.at(1.5) == []
    bench.links.shut(UP, False)
    assert "loss 50%" in bench.tc.said[-1]


def test_a_change_that_the_kernel_refuses_is_not_held(made: Made) -> None:
    bench = made(plan_of(EventPlan(1.0, UP, 1.0, {"loss": 0.5})), always=True)
    bench.links.start(1000 * S)
    bench.tc.refuses = "loss 20%"
    with pytest.raises(NetError, match=r"tc qdisc change dev air-uav1-up .*: Error: Specified qdisc kind is unknown."):
        bench.hold({"loss": 0.2})
    assert len(bench.at(1.0)) == 1
    with pytest.raises(PlanError, match="expected the commands for it, since netem shapes"):
        bench.links.hold(UP, {"loss": 0.2}, [])


def test_a_link_without_stages_cannot_be_changed(made: Made) -> None:
    bench = made(plan_of(delay_us=1000))
    with pytest.raises(NetError, match=r"wan:gs:up: has no stages in this run; expected `always` in plan\.json"):
        bench.links.hold("wan:gs:up", {"loss": 0.2}, [["tc"]])


def test_in_the_end_all_devices_are_removed(made: Made) -> None:
    bench = made(plan_of(delay_us=1000))
    bench.links.end()
    assert bench.tc.said[-1] == f"ip link del {DEVICE}"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"begin": None}, "kernel.begin None: expected a list of commands"),
        ({"begin": [["rm", "x"]]}, "kernel.begin[0] 'rm': expected one of ip, tc"),
        ({"begin": [["tc", "@uav9"]]}, "kernel.begin[0] '@uav9': expected one of @gs, "),
        ({"links": {UP: {"device": "x"}}}, f"kernel.links.{UP}.device 'x': expected a device that a filter of begin"),
    ],
)
def test_a_kernels_part_that_makes_no_sense_is_named(
    change: dict[str, Any], said: str, monkeypatch: pytest.MonkeyPatch, made: Made
) -> None:
    written = host.run_plan(plan_of(delay_us=1000), TOPOLOGY)
    written["kernel"] |= change
    monkeypatch.setattr(host, "run_plan", lambda *_, **__: written)
    with pytest.raises(PlanError) as error:
        made(plan_of())
    assert said in str(error.value)


def test_netem_is_chosen_where_it_can_do_everything(made: Made) -> None:
    run = made(plan_of(delay_us=1000)).run
    kernel = FakeTc()
    assert choose(run, kernel).shaper == "netem"
    assert kernel.said[-2:] == ["ip link del net-try-1", "ip link del net-try-2"]
    assert choose(replace(run, shaper="nfqueue"), kernel).shaper == "nfqueue"
    without = FakeTc(refuses="netem")
    assert choose(run, without).shaper == "nfqueue"
    assert "Specified qdisc kind is unknown" in choose(run, without).why
    with pytest.raises(NetError, match=r"plan.json: shaper 'netem': tc qdisc add .* unknown\.; expected a kernel that"):
        choose(replace(run, shaper="netem"), without)


@pytest.mark.parametrize("lacking", ["type ifb", "htb", "clsact", "u32", "skbedit", "mirred", "fw", "seed"])
def test_whatever_is_lacking_there_is_no_netem(lacking: str) -> None:
    assert try_netem(FakeTc(refuses=lacking)) is not None


def test_a_command_that_fails_is_named_by_its_place() -> None:
    def runner(words: Any, text: str | None) -> Done:
        return Done(1, "", "Cannot find device\nCommand failed -:2") if words[0] == "tc" else Done(0, "[1] [2]", "")

    with pytest.raises(NetError) as error:
        carry_out([["ip", "a"], ["tc", "b"], ["tc", "c"], ["tc", "d"]], runner, "begin")
    assert str(error.value) == "begin[2]: tc c: Cannot find device"
    assert carry_out([["ip", "a"]], runner, "begin") == [[1], [2]]
