"""When a state is published: deadband, rate and heartbeat (section 3)."""

from __future__ import annotations

import pytest

from mqttxt.protocol.policies import Policy, Throttle
from mqttxt.protocol.states import (
    Armed,
    Battery,
    FlightMode,
    FlightModeName,
    Groundspeed,
    Heading,
    Home,
    Location,
    State,
)


@pytest.mark.parametrize(
    ("first", "within", "beyond"),
    [
        (Battery(50), Battery(50), Battery(49)),
        (Heading(358.0), Heading(3.0), Heading(3.1)),
        (Groundspeed(5.0), Groundspeed(5.4), Groundspeed(5.6)),
        (Location(47.0, 8.0, 488.0, 0.0), Location(47.000004, 8.0, 488.4, 0.4), Location(47.000005, 8.0, 488.0, 0.0)),
        (Location(47.0, 8.0, 488.0, 0.0), Location(47.0, 8.0, 488.5, 0.5), Location(47.0, 8.0, 488.6, 0.6)),
        (Location(47.0, 8.0, 488.0, 0.0), Location(47.0, 8.0, 488.0, 0.5), Location(47.0, 8.0, 488.0, 0.6)),
        (Home(47.0, 8.0, 488.0), Home(47.000008, 8.0, 489.0), Home(47.00001, 8.0, 488.0)),
    ],
)
def test_a_change_within_the_deadband_waits_and_one_beyond_does_not(first: State, within: State, beyond: State) -> None:
    throttle = Throttle()
    throttle.update(first)
    assert throttle.due(0) == [first]
    throttle.update(within)
    assert throttle.due(5000) == []
    throttle.update(beyond)
    assert throttle.due(5000) == [beyond]


def test_a_battery_that_wavers_between_two_figures_is_told_once() -> None:
    throttle = Throttle()
    published: list[State] = []
    for second, percent in enumerate((62, 61, 62, 61, 62, 61, 60, 61, 60, 59, 61)):
        throttle.update(Battery(percent))
        published += throttle.due(second * 2000)
    assert published == [Battery(each) for each in (62, 61, 60, 59, 61)]


def test_home_at_rest_has_a_deadband_and_as_of_arming_is_exact() -> None:
    throttle = Throttle()
    throttle.update(Armed(False))
    throttle.update(Home(47.0, 8.0, 488.0))
    throttle.due(0)
    throttle.update(Home(47.0, 8.000005, 488.9))
    assert throttle.due(2000) == []
    throttle.update(Armed(True))
    throttle.update(Home(47.0, 8.000005, 488.4))
    assert throttle.due(3000) == [Armed(True), Home(47.0, 8.000005, 488.4)]


def test_slow_drift_is_compared_with_what_was_published() -> None:
    throttle = Throttle()
    published = []
    for step in range(20):
        throttle.update(Groundspeed(5.0 + step / 10))
        published += throttle.due(step * 2000)
    assert [state.groundspeed_m_s for state in published] == [5.0, 5.6, 6.2, 6.8]  # type: ignore[union-attr]


def test_not_more_often_than_the_rate_and_then_the_newest() -> None:
    throttle = Throttle()
    throttle.update(Battery(50))
    throttle.due(0)
    for at_ms, remaining in ((100, 49), (500, 48), (999, 47)):
        throttle.update(Battery(remaining))
        assert throttle.due(at_ms) == []
    assert throttle.due(1000) == [Battery(47)]


def test_modes_and_arming_pass_at_ten_hertz() -> None:
    throttle = Throttle()
    throttle.update(Armed(False))
    throttle.update(FlightMode(FlightModeName.HOLD))
    assert len(throttle.due(0)) == 2
    throttle.update(Armed(True))
    assert throttle.due(99) == []
    assert throttle.due(100) == [Armed(True)]


def test_an_unchanged_state_is_repeated_every_heartbeat_interval() -> None:
    throttle = Throttle()
    throttle.update(Battery(50))
    assert [now for now in range(0, 90_001, 1000) if throttle.due(now)] == [0, 30_000, 60_000, 90_000]


def test_policies_can_be_configured_and_what_was_published_forgotten() -> None:
    throttle = Throttle({"battery": Policy(lambda old, new: False, 0, heartbeat_ms=500)})
    throttle.update(Battery(50))
    assert [now for now in range(0, 1001, 250) if throttle.due(now)] == [0, 500, 1000]
    throttle.forget_published()
    assert throttle.due(1001) == [Battery(50)]
