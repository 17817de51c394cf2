"""What counts: a table of observations and their verdicts, and that nothing else in the testbed makes a verdict."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import testbed
from testbed.errors import DockerError
from testbed.fly.results import Attempt
from testbed.fly.validity import (
    CUT_OFF,
    INTERRUPTED,
    WATCHED,
    Observed,
    Verdict,
    as_measured,
    cut_off,
    judge,
    paired,
    unmeasured,
    unread,
    written,
)

LATE = "the emulator did not keep up"
SLOW = "uav1: the autopilot's clock ran at 0.70 of the time"
FORWARD = "the machine's clock was set forward, or the machine was suspended, by 3600.000 s during the attempt"
DENIED = "arm: drone 3: denied"
DOCKER_GONE = cut_off(DockerError("Docker does not answer"))


@pytest.mark.parametrize(
    ("seen", "verdict"),
    [
        (Observed(), Verdict("completed")),
        (Observed(failure=DENIED), Verdict("failed", (DENIED,))),
        (Observed(off_before="wan:gs:up delay: 9 ms"), Verdict("void", ("wan:gs:up delay: 9 ms",))),
        (Observed(failure=INTERRUPTED, off_before="wan"), Verdict("void", ("wan",))),
        # conditions under which any mission proves nothing
        (Observed(off_links=(LATE,)), Verdict("void", (LATE,))),
        (Observed(watched=True), Verdict("void", (WATCHED,))),
        (Observed(failure=DENIED, off_links=(LATE,), watched=True), Verdict("void", (WATCHED,), DENIED)),
        (Observed(flights=(SLOW,)), Verdict("void", (SLOW,))),
        (Observed(failure=DENIED, off_links=(LATE,)), Verdict("void", (LATE,), DENIED)),
        (Observed(failure=DENIED, flights=(SLOW,)), Verdict("void", (SLOW,), DENIED)),
        (Observed(clock_set=3600.0), Verdict("void", (FORWARD,))),
        (Observed(failure=DENIED, clock_set=3600.0), Verdict("void", (FORWARD,), DENIED)),
        (
            Observed(clock_set=-2.5),
            Verdict("void", ("the machine's clock was set back by 2.500 s during the attempt",)),
        ),
        (Observed(failure=DENIED, dropped={"gs": 3}), Verdict("void", ("captures dropped packets: gs 3",), DENIED)),
        # the run's own end counts against nobody
        (Observed(failure=INTERRUPTED, off_links=(LATE,)), Verdict("void", (INTERRUPTED,))),
        (Observed(failure=CUT_OFF, flights=(SLOW,)), Verdict("void", (CUT_OFF,))),
        (Observed(failure=DOCKER_GONE), Verdict("void", (DOCKER_GONE,))),
        # what only the numbers of a completed mission need
        (Observed(uncaptured=("fog1", "uav2")), Verdict("void", ("no capture at fog1, uav2",))),
        (Observed(dropped={"gs": 3, "uav1": None}), Verdict("void", ("captures dropped packets: gs 3, uav1 ?",))),
        (Observed(has_end=False), Verdict("void", ("events.jsonl does not have the mission's end",))),
        (Observed(silent=("uav2",)), Verdict("void", ("no autopilot's own word of disarming: uav2",))),
        (
            Observed(set_back=("gs.pcap", 3.0)),
            Verdict("void", ("the clock was set back by 3.000 s during the attempt (gs.pcap)",)),
        ),
        (
            Observed(unreadable=("events.jsonl, line 1: not JSON",)),
            Verdict("void", ("events.jsonl, line 1: not JSON",)),
        ),
        (
            Observed(DENIED, None, (), (), ("uav2",), {}, False, ("uav2",), ("gs.pcap", 3.0), ("x: not JSON",)),
            Verdict("failed", (DENIED,)),
        ),
        # every reason is given
        (
            Observed(off_links=(LATE, "air:uav1:up loss"), flights=(SLOW,), uncaptured=("gs",)),
            Verdict("void", ("no capture at gs", LATE, "air:uav1:up loss", SLOW)),
        ),
    ],
)
def test_observations_and_their_verdict(seen: Observed, verdict: Verdict) -> None:
    assert judge(seen) == verdict


def test_a_verdict_is_written_as_its_status_and_one_line_and_read_back() -> None:
    assert Verdict("completed").to_data() == {"status": "completed", "reason": None}
    void = Verdict("void", (LATE, SLOW), DENIED)
    assert void.reason == f"{LATE}; {SLOW}; this one had failed: {DENIED}"
    assert written(void.to_data()).to_data() == void.to_data()
    assert written({"status": "running", "reason": None}) == Verdict("void", (CUT_OFF,))
    for reason in (CUT_OFF, INTERRUPTED, DOCKER_GONE):
        assert written({"status": "failed", "reason": reason}) == Verdict("void", (reason,))
    assert written({"status": "failed", "reason": DENIED}) == Verdict("failed", (DENIED,))


def test_with_one_attempt_of_a_pair_the_other_is_void_and_no_third() -> None:
    mqttxt, mavlink, again, other = (
        Attempt(Path(), protocol, number, repeat)
        for protocol, number, repeat in (("mqttxt", 1, 0), ("mavlink", 1, 0), ("mavlink", 1, 1), ("mqttxt", 2, 0))
    )
    verdicts = {
        mqttxt: Verdict("failed", (DENIED,)),
        mavlink: Verdict("void", (LATE,)),
        again: Verdict("completed"),
        other: Verdict("completed"),
    }
    with_it = Verdict("void", ("mavlink was void in the same attempt",), DENIED)
    assert paired(verdicts) == verdicts | {mqttxt: with_it}


def test_what_can_no_longer_be_measured_is_void_unless_it_failed() -> None:
    assert unmeasured(Verdict("completed"), "gs.pcap: not a capture") == Verdict("void", ("gs.pcap: not a capture",))
    assert unmeasured(Verdict("failed", (DENIED,)), "gs.pcap: not a capture") == Verdict("failed", (DENIED,))
    assert unread("manifest.json: not JSON") == as_measured({"reason": "manifest.json: not JSON"})


@pytest.mark.parametrize(
    ("verdict", "cut"),
    [
        (Verdict("completed"), False),
        (Verdict("failed", (DENIED,)), False),
        (Verdict("failed", (INTERRUPTED,)), True),
        (Verdict("void", (CUT_OFF,)), True),
        (Verdict("void", (DOCKER_GONE,)), True),
        (Verdict("void", (LATE, CUT_OFF)), False),
    ],
)
def test_an_attempt_was_cut_when_its_run_ended_first(verdict: Verdict, cut: bool) -> None:
    assert verdict.was_cut is cut


@pytest.mark.long
def test_no_other_module_of_the_testbed_makes_a_verdict() -> None:
    """Neither by the class nor by a status that it writes itself, but for a manifest's before it is judged."""
    makers = {}
    for path in sorted(Path(str(testbed.__file__)).parent.rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        made = [
            node.func.id for node in ast.walk(tree) if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
        ]
        found = [f"{name}(" for name in made if name in ("Verdict", "Observed")]
        for node in ast.walk(tree):
            for key, value in zip(node.keys, node.values, strict=True) if isinstance(node, ast.Dict) else ():
                if isinstance(key, ast.Constant) and key.value == "status" and isinstance(value, ast.Constant):
                    found.append(f"status: {value.value}")
        if found:
            makers[path.name] = set(found)
    assert makers == {
        "validity.py": {"Verdict("},
        "observations.py": {"Observed("},
        "runner.py": {"Observed("},
        "manifest.py": {"status: running"},
    }
