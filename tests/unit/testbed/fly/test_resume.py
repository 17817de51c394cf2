"""A series that was broken off: what of it counts, what is flown again, and when it is left as it is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from testbed.fly import resume
from testbed.fly.results import METRICS, Series, new_series, read_json, write_json
from testbed.fly.resume import begun_of, given_up, is_measured, next_number, otherwise, settle, to_fly
from testbed.fly.runner import run_series
from testbed.plan.experiments import Plan, make_plan
from tests.handmade.made_up_fleet import HERE, Fleet, Quiet

pytestmark = pytest.mark.usefixtures("made_up")


def plan_of(attempts: int = 2, **changed: Any) -> Plan:
    return make_plan("scenario-1", str(attempts), "thesis", "ideal", **changed)


@pytest.fixture
def series(series: Series) -> Series:
    """Attempt 1 of both, completed."""
    run_series(plan_of(1), series, Quiet(), Fleet([]))
    return series


def go_on(series: Series, plan: Plan, fleet: Fleet | None = None) -> list[tuple[str, int, int]]:
    """Goes on with a series; returns what was flown: protocol, number and repeat."""
    progress = Quiet()
    settle(series, plan)
    run_series(plan, series, progress, fleet or Fleet([]), begun=begun_of(series, plan))
    said = [one for one in progress.said if isinstance(one, tuple) and len(one) == 4]
    return [(protocol, number, repeat) for protocol, number, _, repeat in said]


def change(series: Series, folder: str, **changed: Any) -> None:
    path = series.path / folder / "manifest.json"
    write_json(path, read_json(path) | changed)


def manifest_of(series: Series, folder: str) -> dict[str, Any]:
    return read_json(series.path / folder / "manifest.json")


def test_what_was_flown_stays_and_the_rest_follows_in_its_order(series: Series) -> None:
    plan = plan_of(3)
    assert next_number(begun_of(series, plan), plan) == 2
    assert to_fly(begun_of(series, plan), plan) == {"mqttxt": 2, "mavlink": 2}
    assert go_on(series, plan) == [("mavlink", 2, 0), ("mqttxt", 2, 0), ("mqttxt", 3, 0), ("mavlink", 3, 0)]
    assert next_number(begun_of(series, plan), plan) is None


def test_a_failed_attempt_counts_and_is_not_flown_again(series: Series) -> None:
    change(series, "mavlink/attempt-01", status="failed", reason="arm: drone 2: denied")
    assert next_number(begun_of(series, plan_of(1)), plan_of(1)) is None


def test_the_side_that_lacks_is_flown_alone(tmp_path: Path) -> None:
    series = new_series(tmp_path, "scenario-1", "thesis", "ideal")
    run_series(plan_of(1, protocols="mqttxt"), series, Quiet(), Fleet([]))
    assert go_on(series, plan_of(1)) == [("mavlink", 1, 0)]


@pytest.mark.parametrize(("status", "reason"), [("running", None), ("failed", "interrupted")])
def test_an_attempt_that_was_cut_off_is_void_with_its_pair_and_both_are_flown_again(
    series: Series, status: str, reason: str | None
) -> None:
    change(series, "mavlink/attempt-01", status=status, reason=reason)
    assert go_on(series, plan_of(1)) == [("mqttxt", 1, 1), ("mavlink", 1, 1)]
    cut, other = (manifest_of(series, f"{side}/attempt-01") for side in ("mavlink", "mqttxt"))
    assert (cut["status"], cut["reason"]) == ("void", "the run was cut off")
    assert (other["status"], other["reason"]) == ("void", "mavlink was void in the same attempt")
    assert go_on(series, plan_of(1)) == []


def test_an_attempt_that_docker_cut_off_is_flown_again_with_its_reason_kept(series: Series) -> None:
    reason = "the run was cut off: Docker does not answer"
    change(series, "mavlink/attempt-01", status="void", reason=reason)
    assert begun_of(series, plan_of(1))[1].left == 3
    assert go_on(series, plan_of(1)) == [("mqttxt", 1, 1), ("mavlink", 1, 1)]
    assert manifest_of(series, "mavlink/attempt-01")["reason"] == reason


def test_a_damaged_manifest_does_not_keep_the_rest_from_being_flown(series: Series) -> None:
    (series.path / "mavlink" / "attempt-01" / "manifest.json").write_text("{half")
    assert go_on(series, plan_of(1)) == [("mqttxt", 1, 1), ("mavlink", 1, 1)]


def test_an_attempt_without_a_manifest_was_cut_off(series: Series) -> None:
    (series.path / "mqttxt" / "attempt-02").mkdir()
    assert go_on(series, plan_of(2)) == [("mavlink", 2, 1), ("mqttxt", 2, 1)]


def test_being_cut_off_is_no_repeat_of_those_that_a_number_may_have(series: Series) -> None:
    for _ in range(4):
        last = sorted((series.path / "mavlink").iterdir())[-1].name
        change(series, f"mavlink/{last}", status="failed", reason="interrupted")
        assert len(go_on(series, plan_of(1))) == 2
    assert begun_of(series, plan_of(1))[1].left == 3


def test_a_number_that_was_void_three_times_is_given_up_with_its_reason(tmp_path: Path) -> None:
    series = new_series(tmp_path, "scenario-1", "thesis", "ideal")
    run_series(plan_of(1), series, Quiet(), Fleet([], dropped=2))
    begun = begun_of(series, plan_of(1))
    assert given_up(begun) == {1: "captures dropped packets: gs 2"}
    assert next_number(begun, plan_of(1)) is None
    assert to_fly(begun, plan_of(1)) == {"mqttxt": 0, "mavlink": 0}
    assert go_on(series, plan_of(2)) == [("mavlink", 2, 0), ("mqttxt", 2, 0)]


def test_a_void_number_goes_on_with_the_repeats_that_it_has_left(series: Series) -> None:
    for side in ("mqttxt", "mavlink"):
        change(series, f"{side}/attempt-01", status="void", reason="a link was off")
    flown = go_on(series, plan_of(1), Fleet([], dropped=2))
    assert flown == [("mqttxt", 1, 1), ("mqttxt", 1, 2)]
    assert list(given_up(begun_of(series, plan_of(1)))) == [1]


def test_what_was_found_void_when_measured_is_flown_again_with_its_pair(series: Series) -> None:
    void = [{"attempt": 1, "reason": "the clock was set"}]
    write_json(series.path / METRICS, {"protocols": {"mavlink": {"attempts": [], "void": void}}})
    assert go_on(series, plan_of(1)) == [("mqttxt", 1, 1), ("mavlink", 1, 1)]
    assert manifest_of(series, "mqttxt/attempt-01")["reason"] == "mavlink was void in the same attempt"


def test_what_was_reported_while_it_was_flown_counts_once_it_is_complete(series: Series) -> None:
    cut, paired = "the run was cut off", "mavlink was void in the same attempt"
    sides = {"mavlink": {"attempts": [], "void": [{"attempt": 1, "reason": cut}]}}
    sides["mqttxt"] = {"attempts": [], "void": [{"attempt": 1, "reason": paired}]}
    write_json(series.path / METRICS, {"protocols": sides})
    assert go_on(series, plan_of(1)) == []
    assert [manifest_of(series, f"{side}/attempt-01")["status"] for side in sides] == ["completed"] * 2


def test_a_series_is_measured_when_its_metrics_know_every_attempt(series: Series) -> None:
    assert not is_measured(series)
    side: dict[str, Any] = {"attempts": [{"attempt": 1, "repeat": 0}], "void": []}
    write_json(series.path / METRICS, {"protocols": {"mqttxt": side, "mavlink": side}})
    assert is_measured(series)
    go_on(series, plan_of(2))
    assert not is_measured(series)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"revision": {"commit": "decaf", "dirty": False}}, "it was flown at another revision"),
        ({"revision": {"commit": "c0ffee", "dirty": True}}, "it was flown at another revision"),
        ({"configuration": {"qos": 1}}, "it was configured otherwise"),
        ({"host": {"name": "another"}}, "it was flown on another machine"),
    ],
)
def test_a_series_flown_otherwise_is_left_as_it_is(series: Series, changed: dict[str, Any], said: str) -> None:
    change(series, "mqttxt/attempt-01", **changed)
    assert otherwise(series, plan_of()) == said


def test_a_series_in_the_order_of_another_seed_is_left_as_it_is(series: Series) -> None:
    assert otherwise(series, replace(plan_of(), order_seed=7)) == "who flies first was drawn from another seed"
    for side in ("mqttxt", "mavlink"):
        change(series, f"{side}/attempt-01", seeds={"sitl": 1, "links": 1, "order": 7})
    assert otherwise(series, replace(plan_of(), order_seed=7)) is None
    assert otherwise(series, replace(plan_of(), order_seed=8)) == "who flies first was drawn from another seed"


def test_a_series_on_other_links_is_left_as_it_is(series: Series) -> None:
    path = series.path / "mqttxt" / "attempt-01" / "links" / "plan.json"
    write_json(path, read_json(path) | {"always": True})
    assert otherwise(series, plan_of()) == "its links were planned otherwise"


def test_with_changes_that_are_in_no_revision_nothing_is_gone_on_with(
    series: Series, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(resume, "revision", lambda: HERE | {"dirty": True})
    assert otherwise(series, plan_of()) == "what is here now is in no revision"
