"""Statistics over attempts, with answers that one can work out by hand."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from testbed.numbers import quantities
from testbed.numbers.metrics.delays import summary
from testbed.numbers.observed import observe
from testbed.numbers.statistics import ALL_SIGNS, interval, loss_of, paired_test
from tests.examples import examples
from tests.handmade.both_sides import entry, failed


def attempts(protocol: str, *packets: int) -> list[dict[str, Any]]:
    return [entry(protocol, n, packets=count, memory_bytes={}) for n, count in enumerate(packets, 1)]


def statistics(protocols: dict[str, Any]) -> dict[str, Any]:
    return quantities.statistics(observe(protocols))


def side(*found: dict[str, Any], void: int = 0) -> dict[str, Any]:
    return {"attempts": list(found), "void": [{"attempt": 90 + n, "reason": "?"} for n in range(void)]}


def test_below_six_attempts_there_are_points_and_no_interval_and_no_test() -> None:
    protocols = {p: side(*attempts(p, 10, 30, 20, 20, 40)) for p in ("mavlink", "mqttxt")}
    packets = statistics(protocols)["metrics"]["packets"]
    assert packets["mqttxt"] == {
        **{"n": 5, "mean": 24.0, "median": 20.0, "interval": None},
        "points": {"1": 10.0, "2": 30.0, "3": 20.0, "4": 20.0, "5": 40.0},
    }
    assert packets["test"] is None


def test_six_pairs_that_all_differ_one_way_are_as_unlikely_as_two_in_sixty_four() -> None:
    protocols = {
        "mavlink": side(*attempts("mavlink", 110, 120, 130, 140, 150, 160)),
        "mqttxt": side(*attempts("mqttxt", 10, 10, 10, 10, 10, 10)),
    }
    packets = statistics(protocols)["metrics"]["packets"]
    assert packets["test"] == {"pairs": 6, "difference": 125.0, "p": 2 / 64, "effect": 1.0}
    low, high = packets["mavlink"]["interval"]
    assert 110 < low < 135 < high < 160
    assert packets["mqttxt"]["interval"] == [10.0, 10.0]


def test_sides_that_do_not_differ_have_no_effect() -> None:
    assert paired_test([0.0] * 6) == {"pairs": 6, "difference": 0.0, "p": 1.0, "effect": 0.0}
    balanced = paired_test([1.0, -1.0, 2.0, -2.0, 3.0, -3.0])
    assert balanced == {"pairs": 6, "difference": 0.0, "p": 1.0, "effect": 0.0}


def test_ranks_that_are_shared_are_shared_out() -> None:
    found = paired_test([1.0, 1.0, 1.0, 1.0, 1.0, -1.0])
    assert found is not None
    assert found["effect"] == pytest.approx(4 / 6, abs=1e-8)  # every rank is 3.5: five up, one down
    assert found["p"] == pytest.approx(14 / 64)  # at most one sign of the six is another


def test_many_pairs_are_tested_by_a_fixed_choice_of_signs() -> None:
    differences = [1.0 + n for n in range(ALL_SIGNS + 1)]
    found = paired_test(differences)
    assert found == paired_test(differences)
    assert found is not None
    assert 0 < found["p"] < 0.01


def test_only_attempts_of_the_same_number_make_a_pair() -> None:
    mqttxt = attempts("mqttxt", *range(10, 17))
    mavlink = [one for one in attempts("mavlink", *range(110, 117)) if one["attempt"] != 3]
    packets = statistics({"mavlink": side(*mavlink), "mqttxt": side(*mqttxt)})["metrics"]["packets"]
    assert (packets["mqttxt"]["n"], packets["mavlink"]["n"], packets["test"]["pairs"]) == (7, 6, 6)


def test_a_failed_attempt_is_counted_and_has_no_point_and_a_void_one_counts_for_nothing() -> None:
    gave_up = failed("mqttxt", "takeoff: denied", 3, memory_bytes={})
    found = statistics({"mqttxt": side(*attempts("mqttxt", 10, 20), gave_up, void=2)})
    assert found["completion"]["mqttxt"] == {"flown": 3, "completed": 2, "failed": 1, "void": 2}
    assert found["metrics"]["mission_s"]["mqttxt"]["points"] == {"1": 36.5, "2": 36.5}
    assert found["metrics"]["memory_bytes"]["mqttxt"] == {
        **{"n": 0, "mean": None, "median": None, "interval": None, "points": {}}
    }


def test_none_lost_of_n_is_less_than_three_in_n() -> None:
    assert loss_of(300, 0) == {"sent": 300, "lost": 0, "share": 0.0, "below": 0.01}
    assert loss_of(300, 3) == {"sent": 300, "lost": 3, "share": 0.01, "below": None}
    assert loss_of(2, 0)["below"] == 1.0
    assert loss_of(310, 0, still_open=10)["below"] == 0.01
    assert loss_of(0, 0) == {"sent": 0, "lost": 0, "share": None, "below": None}


def test_losses_of_all_completed_attempts_are_pooled() -> None:
    lossy = [
        one | {"messages": {"commands": {"arm": {"sent": 6, "lost": lost, "open": 0}}, "states": {}}}
        for one, lost in zip(attempts("mqttxt", 10, 20), (1, 0), strict=True)
    ]
    found = statistics({"mqttxt": side(*lossy)})["losses"]
    assert found["commands"]["mqttxt"] == loss_of(12, 1)
    assert found["states"]["mqttxt"] == loss_of(0, 0)
    assert found["frames"]["mqttxt"] == loss_of(30, 0)


def test_a_99th_percentile_needs_a_thousand_values() -> None:
    few, many = summary([float(n) for n in range(999)]), summary([float(n) for n in range(1000)])
    assert (few["n"], few["mean"], few["p50"], few["p99"], few["max"]) == (999, 499.0, 499.0, None, 998.0)
    assert many["p99"] == 989.01
    assert summary([]) == {"n": 0, "mean": None, "p50": None, "p90": None, "p99": None, "max": None}


@examples(15)
@given(st.lists(st.floats(-1e6, 1e6), min_size=6, max_size=8))
def test_an_interval_lies_within_its_points_and_a_p_between_0_and_1(points: list[float]) -> None:
    found, tested = interval(points), paired_test(points)
    assert found is not None
    assert tested is not None
    slack = 1e-6 + 1e-8 * max(map(abs, points))
    assert min(points) - slack <= found[0] <= found[1] <= max(points) + slack
    assert 0 < tested["p"] <= 1
    assert -1 <= tested["effect"] <= 1
    assert interval(points) == found
