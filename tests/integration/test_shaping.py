"""`net route` with shaped links, real packets and no more rights than compose.yaml gives: start, changes, gates."""

from __future__ import annotations

import json
from statistics import median
from typing import Any

import pytest

from tests.rigs.processes import wait_until
from tests.rigs.shaped_link import CONTROL, DOWN, LINKS, SUBNETS, UP, Emulator, ShapedLink, plan_of
from tests.rigs.shaped_nodes import FOLDER, PYTHON

pytestmark = [
    pytest.mark.integration,
    pytest.mark.alone,
    pytest.mark.timeout(120),
    pytest.mark.soak(
        "services/net/src", "tests/rigs/shaped_link.py", "tests/rigs/shaped_nodes.py", "tests/rigs/link_probe.py"
    ),
]
OK = '{"ok": true}\n'
GATE = {"link": "wan:gs", "drone": 1, "latitude_deg": 47.4, "longitude_deg": 8.5, "range_m": 50.0}
STEADY = {"delay_us": 20_000}


def events(running: Emulator) -> list[dict[str, Any]]:
    return [json.loads(line) for line in running.read("events.jsonl").splitlines()]


def changes(running: Emulator) -> list[tuple[str, Any, str]]:
    return [(event["link"], event["change"], event["cause"]) for event in events(running) if "link" in event]


def change(link: ShapedLink, *words: str) -> str:
    """What is answered to a change, asked for without any right, as the host does."""
    code, said = link.net([PYTHON, "-m", "net", "change", "--control", CONTROL, *words], user="1000:1000")
    assert len(said.splitlines()) == 1
    assert (code == 0) == (said == OK)
    return said


def answered(link: ShapedLink) -> int:
    """Of five requests, how many went up and came back down."""
    ping = ["ping", "-n", "-c", "5", "-i", "0.02", "-W", "1", f"{SUBNETS['cloud']}.3"]
    said = link.nodes["gs"].exec_run(ping).output.decode()
    return int(said.split(" received")[0].rsplit(" ", 1)[1])


def test_events_wait_for_the_start_and_count_from_it(link: ShapedLink) -> None:
    closing = {"at_s": 1.0, "for_s": 2.0, "link": UP, "change": {"closed": True}}
    with link.routing(plan_of(STEADY, [closing])) as running:
        said = json.loads(running.read("shaper.json"))
        assert said["shaper"] == "nfqueue"
        assert said["checked"]["queues"] == 2
        rows = running.flow(300, 200, 100, silence_s=0.4)  # 1.5 s: past the event's time, were it not for the start
        assert len(rows) == 300
        assert median(row.delay_ms for row in rows) >= 20.0
        link.output("net", ["touch", f"{LINKS}/start"])
        wait_until(lambda: (UP, None, "profile") in changes(running), "its events")
        found = events(running)
        start_ns = next(event["t_ns"] for event in found if event.get("event") == "start")
        (closed_ns,) = (event["t_ns"] for event in found if event.get("change") == {"closed": True})
        assert closed_ns - start_ns >= 1_000_000_000
        assert len(running.flow(100, 200, 100, silence_s=0.4)) == 100
        content = running.end()
    assert content["shaper"] == "nfqueue"
    assert (content["at_start"][UP]["left"], content["links"][UP]["left"]) == (300, 400)


def test_a_link_is_changed_by_hand_and_back(link: ShapedLink) -> None:
    with link.routing(plan_of({}), always=True) as running:
        assert answered(link) == 5
        assert change(link, UP, "closed=true") == OK
        assert answered(link) == 0
        request = {"link": UP, "change": {"delay_us": 30_000, "duplicate": 1.0}, "kernel": []}
        assert change(link, json.dumps(request)) == OK
        rows = running.flow(20, 200, 100, silence_s=0.4)
        assert len(rows) == 40, "it could not be doubled before, and is now"
        assert min(row.delay_ms for row in rows) >= 30.0
        assert change(link, UP) == OK
        assert answered(link) == 5
        assert changes(running) == [
            (UP, {"closed": True}, "hand"),
            (UP, {"delay_us": 30_000, "duplicate": 1.0}, "hand"),
            (UP, None, "hand"),
        ]


def test_a_change_that_makes_no_sense_is_refused_in_one_line(link: ShapedLink) -> None:
    refused = {
        (UP, "loss=2"): f"{UP}.change.loss 2: expected a share from 0 to 1",
        (UP, "speed=2"): f"{UP}.change: unknown field 'speed'; expected rate_bps, ",
        ("wan:gs", "loss=1"): f"link 'wan:gs': expected one of {UP}, {DOWN}",
        ("{}",): "{}: expected an object with link, change and, with netem, kernel",
    }
    with link.routing(plan_of({}), always=True) as running:
        for words, said in refused.items():
            assert json.loads(change(link, *words))["error"].startswith(said)
        assert change(link, UP, "loss") == "net: 'loss': expected FIELD=VALUE, as loss=0.2\n"
        assert changes(running) == []


def test_a_gate_is_open_while_the_drone_is_near(link: ShapedLink) -> None:
    def fly(latitude_deg: float) -> None:
        position = json.dumps({"t_ns": 1, "latitude_deg": latitude_deg, "longitude_deg": 8.5, "altitude_m": 10.0})
        file = f"{FOLDER}/sitl/uav1.position.json"
        link.output("net", ["sh", "-c", f"printf %s '{position}' > {file}.new && mv {file}.new {file}"])

    shut = {(UP, "closed"), (DOWN, "closed")}
    with link.routing(plan_of({}), gates=[GATE]) as running:
        assert {(name, *change) for name, change, _ in changes(running)} == shut, "before there is any position"
        assert answered(link) == 0
        fly(47.4004)  # 44 m
        wait_until(lambda: len(changes(running)) == 4, "its events")
        assert changes(running)[2:] == [(UP, None, "range"), (DOWN, None, "range")]
        assert answered(link) == 5
        fly(47.4006)  # 67 m
        wait_until(lambda: len(changes(running)) == 6, "its events")
        assert answered(link) == 0
        found = running.end()["links"][UP]
    assert (found["closed"], found["left"]) == (10, 5)


def test_a_plan_that_shapes_nothing_needs_no_shaper(link: ShapedLink) -> None:
    with link.routing(plan_of({})) as running:
        assert json.loads(running.read("shaper.json"))["shaper"] == "none"
        assert answered(link) == 5
        answer = json.loads(change(link, UP, "loss=1"))
        assert answer == {"error": f"{UP}: links are not shaped in this run; expected `always` in plan.json"}
        link.output("net", ["touch", f"{LINKS}/start"])
        wait_until(lambda: len(events(running)) == 1, "its events")
        assert running.end()["shaper"] == "none"


@pytest.mark.parametrize(
    ("plan", "run", "code", "said"),
    [
        (plan_of({"loss": 2}), {}, 2, "plan.json: plan: links.wan:gs:up.loss 2: expected a share from 0 to 1"),
        (plan_of({}), {"shaper": "tc"}, 2, "plan.json: shaper 'tc': expected one of auto, "),
        (plan_of({}), {"gates": [{**GATE, "link": "sense:uav1"}]}, 2, "gates[0].link 'sense:uav1': expected a link of"),
        ({**plan_of(STEADY), "links": {UP: STEADY}}, {}, 2, "links: none from cloud to gs; expected one each way"),
    ],
)
def test_what_cannot_be_shaped_is_not_routed(
    link: ShapedLink, plan: Any, run: dict[str, Any], code: int, said: str
) -> None:
    ended, words = link.route(plan, run)
    assert ended == code, words
    assert said in words
    assert len(words.splitlines()) == 1
    assert link.net(["test", "-e", f"{FOLDER}/ready"])[0] == 1


def test_without_the_right_to_it_says_so_in_one_line(link: ShapedLink) -> None:
    code, words = link.route(plan_of(STEADY), user="1000:1000")
    assert code == 1
    assert words == (
        "net: capabilities 0000000000000000: no CAP_NET_ADMIN; expected cap_add: [NET_ADMIN] as in compose.yaml\n"
    )


def test_once_its_emulator_has_ended_it_ends_too_and_nothing_passes(link: ShapedLink) -> None:
    with link.routing(plan_of(STEADY)) as running:
        running.kill_emulator()
        running.wait_until_ended()
        assert "the emulator ended with exit code -9" in running.read("log")
        assert answered(link) == 0
