"""`net probe`: what is scheduled is sent, what comes is told with the kernel's times; a wrong schedule is one line."""

from __future__ import annotations

import gc
import json
import socket
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from net.probe import HEAD, LARGEST_FRAME, SMALLEST_FRAME, Flow, Probe, ProbeError, Schedule, main, parse_schedule
from tests.rigs.processes import free_port

HERE = "127.0.0.1"
AHEAD_NS = 500_000_000
"""Until a schedule begins; a busy machine may take long to come to it."""
END_S = 1.0
"""When one ends, where nothing is to come at its end."""


def carried_out(*flows: Flow, ahead_ns: int = AHEAD_NS, port: int = 0) -> dict[str, Any]:
    """What a node says that sends to itself."""
    probe = Probe(Schedule(7, time.time_ns() + ahead_ns, END_S, flows), port or free_port(socket.SOCK_DGRAM), HERE)
    try:
        return probe.run()
    finally:
        probe.close()
        gc.enable()


def flow(**changed: Any) -> Flow:
    given = {"flow": 3, "to": HERE, "at_s": 0.0, "burst": 1, "every_s": 0.01, "count": 5, "bytes": 100, "timed": True}
    return Flow(**{**given, **changed})


def document(**changed: Any) -> str:
    each = {"flow": 3, "to": HERE, "at_s": 0.0, "burst": 1, "every_s": 0.01, "count": 5, "bytes": 100, "timed": True}
    return json.dumps({"run": 7, "begin_ns": 1, "end_s": 1.5, "flows": [{**each, **changed}]})


@pytest.fixture(scope="module")
def several() -> dict[str, dict[str, Any]]:
    """What nodes say that each carry out a schedule, all at the same time; and the sizes of a neighbour's frames."""
    sizes = SMALLEST_FRAME, LARGEST_FRAME
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as neighbour, ThreadPoolExecutor() as nodes:
        neighbour.bind(("127.0.0.2", 0))
        neighbour.settimeout(10)
        begun = {
            "five": nodes.submit(carried_out, flow()),
            "two flows": nodes.submit(
                carried_out, flow(flow=1, count=3), flow(flow=2, count=400, burst=400, timed=False)
            ),
            "too long": nodes.submit(carried_out, flow(every_s=10.0)),
            "to a neighbour": nodes.submit(
                carried_out,
                *(flow(flow=size, to="127.0.0.2", count=1, bytes=size) for size in sizes),
                port=neighbour.getsockname()[1],
            ),
        }
        got = [14 + 20 + 8 + len(neighbour.recv(2048)) for _ in sizes]
        return {**{name: node.result() for name, node in begun.items()}, "sizes": {"got": sorted(got)}}


@pytest.mark.long
def test_datagrams_are_sent_when_due_and_told_with_the_kernels_time(several: dict[str, dict[str, Any]]) -> None:
    said = several["five"]
    assert (said["late_ms"], said["overflowed"], said["sent"]) == (0, 0, {"3": 5})
    rows = said["arrived"]["3"]["rows"]
    assert [row[0] for row in rows] == [0, 1, 2, 3, 4]
    assert all(number * 10_000_000 <= sent_ns <= received_ns for number, sent_ns, received_ns in rows)


def test_a_burst_comes_at_once_and_the_others_one_after_the_other() -> None:
    burst = flow(burst=3, count=5, at_s=0.1)
    assert [burst.due_ns(number) for number in range(5)] == [100_000_000] * 3 + [110_000_000, 120_000_000]


def test_flows_are_told_apart_and_untimed_ones_are_only_counted(several: dict[str, dict[str, Any]]) -> None:
    said = several["two flows"]
    assert said["sent"] == {"1": 3, "2": 400}
    assert len(said["arrived"]["1"]["rows"]) == 3
    assert said["arrived"]["2"] == {"count": 400, "rows": []}


def test_a_frame_has_the_size_asked_for(several: dict[str, dict[str, Any]]) -> None:
    assert several["sizes"]["got"] == [SMALLEST_FRAME, LARGEST_FRAME]


@pytest.mark.long
def test_datagrams_of_another_run_and_of_nobodys_are_left_out() -> None:
    port = free_port(socket.SOCK_DGRAM)
    probe = Probe(Schedule(7, time.time_ns() + AHEAD_NS, 0.1, ()), port)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.sendto(HEAD.pack(8, 3, 1, 0, 0), (HERE, port))
        stranger.sendto(b"short", (HERE, port))
        stranger.sendto(HEAD.pack(7, 4, 1, 9, time.time_ns()), (HERE, port))
        said = probe.run()
    probe.close()
    assert list(said["arrived"]) == ["4"]


def test_who_begins_too_late_says_so_and_sends_nothing() -> None:
    said = carried_out(flow(), ahead_ns=-30_000_000)
    assert said["late_ms"] >= 30
    assert said["sent"] == said["arrived"] == {}


def test_the_end_comes_though_not_all_was_sent(several: dict[str, dict[str, Any]]) -> None:
    assert several["too long"]["sent"] == {"3": 1}


def test_two_probes_on_a_node_are_one_too_many() -> None:
    port = free_port(socket.SOCK_DGRAM)
    first = Probe(Schedule(7, 0, 0.0, ()), port)
    with pytest.raises(ProbeError, match=f"UDP port {port}: Address already in use; expected no other probe"):
        Probe(Schedule(7, 0, 0.0, ()), port)
    first.close()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "schedule: not JSON: "),
        ("[]", "schedule: expected an object"),
        ('{"run": 7}', "schedule.begin_ns: None: expected int"),
        ('{"run": true, "begin_ns": 1, "end_s": 1, "flows": []}', "schedule.run: True: expected int"),
        (document(bytes=20), "schedule: flows[0].bytes: 20: expected from 62 to 1514"),
        (document(every_s=-1), "schedule: flows[0].every_s: -1: expected no less than 0"),
        (document(to="nowhere"), "schedule: flows[0].to: 'nowhere': expected an IPv4 address"),
        (document(timed=1), "schedule: flows[0].timed: 1: expected bool"),
    ],
)
def test_a_wrong_schedule_is_one_line_and_exit_code_2(text: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([text]) == 2
    err = capsys.readouterr().err
    assert err.startswith(f"net probe: {said}")
    assert len(err.splitlines()) == 1


def test_a_schedule_is_read_as_it_stands() -> None:
    assert parse_schedule(document()) == Schedule(7, 1, 1.5, (flow(),))


def test_more_than_one_schedule_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["{}", "{}"]) == 2
    assert capsys.readouterr().err == "net probe: expected one schedule, as JSON\n"
