"""Links changed by hand: what is typed, what `net` is told, and what is refused."""

from __future__ import annotations

import json
from typing import Any

import pytest

from testbed.errors import DockerError, UserError
from testbed.fly.live_links import LiveChange, changes, read_live_plan, tell
from testbed.plan.fleets import standard_fleet
from testbed.plan.profiles.reading import read_profile
from testbed.plan.profiles.resolve import LinksPlan, resolve

TOPOLOGY = standard_fleet().topology()


def _plan(profile: str = "ideal") -> LinksPlan:
    return resolve(read_profile(profile), TOPOLOGY, "scenario-1", 1)


def _changes(
    link: str, profile: str = "ideal", *, closed: bool = False, back: bool = False, **typed: str
) -> list[LiveChange]:
    return changes(_plan(profile), TOPOLOGY, link, typed, closed=closed, back=back)


def test_a_link_is_changed_both_ways_and_one_of_its_directions_alone() -> None:
    assert [(change.link, change.change) for change in _changes("air:uav3", loss="20%")] == [
        ("air:uav3:up", {"loss": 0.2}),
        ("air:uav3:down", {"loss": 0.2}),
    ]
    assert [change.link for change in _changes("air:uav3:down", delay="200ms")] == ["air:uav3:down"]


def test_units_are_those_of_a_profile() -> None:
    (change,) = _changes("wan:gs:up", rate="1Mbit", queue="50 packets", delay="30ms", jitter="5ms")
    assert change.change == {"rate_bps": 1_000_000, "queue_packets": 50, "delay_us": 30_000, "jitter_us": 5_000}


def test_a_rate_that_is_lifted_takes_its_queue_along() -> None:
    (change,) = _changes("air:uav1:up", "lte", rate="unlimited")
    assert change.change == {"rate_bps": None, "queue_packets": None}


def test_a_closed_link_and_one_that_is_back_are_told_apart() -> None:
    assert [change.change for change in _changes("air:uav1", closed=True)] == [{"closed": True}] * 2
    assert [change.change for change in _changes("air:uav1", back=True)] == [None, None]


def test_the_kernel_is_told_the_same() -> None:
    (change,) = _changes("air:uav1:up", loss="20%")
    assert any("loss 20%" in " ".join(words) for words in change.kernel)


@pytest.mark.parametrize(
    ("link", "options", "said"),
    [
        ("air:uav9", {"loss": "20%"}, "link air:uav9: expected one of wan:gs, backhaul:fog1, "),
        ("air:uav1", {}, "link air:uav1: expected what to change, as --loss 20%, --closed, or --back"),
        ("air:uav1", {"loss": "20"}, "--loss: '20': expected a share from 0% to 100%, as 1%"),
        ("air:uav1", {"loss": "-1%"}, "--loss: '-1%': expected a share from 0% to 100%, as 1%"),
        ("air:uav1", {"delay": "200"}, "--delay: '200': expected a time with its unit (us, ms, s), as 25ms"),
        ("air:uav1", {"rate": "1Mbit"}, "air:uav1:up: --rate 1Mbit: expected a queue beside it"),
        ("air:uav1", {"jitter": "5ms"}, "air:uav1:up: --jitter 5ms: expected at most the delay"),
        ("air:uav1", {"loss": "1%", "back": True}, "--back: expected no other option"),
    ],
)
def test_a_mistake_is_named_with_what_was_expected(link: str, options: dict[str, Any], said: str) -> None:
    with pytest.raises(UserError) as error:
        _changes(link, **options)
    assert str(error.value).startswith(said)


def test_one_direction_of_a_shared_medium_has_no_rate_of_its_own() -> None:
    with pytest.raises(UserError, match="--rate 32kbit: expected the whole link, the directions of air:uav1 share"):
        _changes("air:uav1:up", "sik", rate="32kbit", queue="10 packets")


def test_the_plan_is_read_from_the_network_that_is_up() -> None:
    plan = _plan("lte")
    assert read_live_plan(lambda command: json.dumps({"plan": plan.to_data()})).links == plan.links
    with pytest.raises(DockerError, match=r"plan\.json: expected the plan of its links, found 'cat: no such file'"):
        read_live_plan(lambda command: "cat: no such file\n")


def test_what_net_says_against_a_change_is_told() -> None:
    (change,) = _changes("wan:gs:up", loss="20%")
    asked: list[list[str]] = []

    def ask(command: list[str]) -> str:
        asked.append(command)
        return json.dumps({"ok": True})

    tell(ask, change)
    assert asked[0][:5] == ["net", "change", "wan:gs:up", "loss=0.2", "--kernel"]
    assert json.loads(asked[0][5]) == [list(words) for words in change.kernel]
    with pytest.raises(DockerError, match="wan:gs:up: the links are not shaped"):
        tell(lambda command: json.dumps({"error": "the links are not shaped"}), change)
    with pytest.raises(DockerError, match="wan:gs:up: ConnectionRefusedError"):
        tell(lambda command: "Traceback\nConnectionRefusedError\n", change)
