"""Events of profiles: when they are, for which links, and that nothing but seed and time decides it."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from random import Random

import pytest

from net.link_plan import EventPlan
from testbed.errors import UserError
from testbed.plan.fleets import standard_fleet
from testbed.plan.profiles.draws import link_seed, occurrences, plan_seed
from testbed.plan.profiles.reading import EventRule, read_profile
from testbed.plan.profiles.resolve import LinksPlan, resolve

TOPOLOGY = standard_fleet().topology()

SECOND = 1_000_000


def _plan(folder: Path, event: str, links: str = "{}", attempt: int = 1, length_s: float = 60) -> LinksPlan:
    path = folder / "own.yaml"
    path.write_text(f"description: own\nlinks: {links}\nevents: [{{{event}, source: s}}]")
    return resolve(read_profile(str(path)), TOPOLOGY, "scenario-1", attempt, length_s)


def _refusal(folder: Path, event: str, links: str = "{}") -> str:
    with pytest.raises(UserError) as raised:
        _plan(folder, event, links)
    return str(raised.value).replace(f"{folder}/", "")


def test_a_timed_event_closes_both_directions_of_its_link(tmp_path: Path) -> None:
    plan = _plan(tmp_path, "link: 'air:uav3', at: 20s, for: 5s, change: {closed: true}")
    assert plan.events == tuple(
        EventPlan(20.0, f"air:uav3:{direction}", 5.0, {"closed": True}) for direction in ("up", "down")
    )


def test_an_event_can_be_for_one_direction_and_for_a_class(tmp_path: Path) -> None:
    one = _plan(tmp_path, "link: 'air:uav3:up', at: 20s, for: 5s, change: {loss: 20%}")
    assert [(event.link, event.change) for event in one.events] == [("air:uav3:up", {"loss": 0.2})]
    many = _plan(tmp_path, "link: 'air:down', at: 20s, for: 5s, change: {delay: 80ms}")
    assert [event.link for event in many.events] == [f"air:uav{drone}:down" for drone in range(1, 7)]
    assert many.events[0].change == {"delay_us": 80_000}


def test_an_event_without_a_duration_stays_and_a_long_one_is_cut_at_the_end(tmp_path: Path) -> None:
    for duration in ("", "for: 100s,"):
        plan = _plan(tmp_path, f"link: wan, at: 20s, {duration} change: {{closed: true}}")
        assert {(event.at_s, event.for_s) for event in plan.events} == {(20.0, 40.0)}


def test_a_periodic_outage_has_a_phase_of_its_attempt_and_of_its_link(tmp_path: Path) -> None:
    outage = "link: air, every: 15s, for: 500ms, change: {closed: true}"
    plans = [_plan(tmp_path, outage, attempt=attempt) for attempt in range(1, 21)]
    phases = []
    for plan in plans:
        times = [event.at_s for event in plan.events if event.link == "air:uav1:up"]
        assert len(times) == 4
        assert [round(later - times[0], 6) for later in times] == [0, 15, 30, 45]
        assert times == [event.at_s for event in plan.events if event.link == "air:uav1:down"]
        phases.append(times[0])
    assert len(set(phases)) == 20
    assert min(phases) < 4
    assert 11 < max(phases) < 15
    assert len({event.at_s for event in plans[0].events if event.link.endswith(":up")}) == 24


def test_the_same_attempt_has_the_same_plan(tmp_path: Path) -> None:
    bursts = "link: air, bursts: {share: 5%, shortest: 100ms, longest: 400ms}, change: {closed: true}"
    assert _plan(tmp_path, bursts) == _plan(tmp_path, bursts)
    assert _plan(tmp_path, bursts) != _plan(tmp_path, bursts, attempt=2)


def test_a_longer_run_meets_the_same_bursts_and_then_more(tmp_path: Path) -> None:
    bursts = "link: 'air:uav1:up', bursts: {share: 5%, shortest: 100ms, longest: 400ms}, change: {closed: true}"
    short, long = _plan(tmp_path, bursts, length_s=60), _plan(tmp_path, bursts, length_s=600)
    assert len(long.events) > len(short.events) > 3
    assert long.events[: len(short.events) - 1] == short.events[:-1]


def test_bursts_take_their_share_of_time_within_their_lengths() -> None:
    rule = EventRule("air", "", {}, "", share=0.05, shortest_us=100_000, longest_us=400_000)
    length_us = 20_000 * SECOND
    found = list(occurrences(rule, Random(7), length_us))
    assert all(100_000 <= for_us <= 400_000 for _, for_us in found[:-1])
    assert sum(for_us for _, for_us in found) / length_us == pytest.approx(0.05, rel=0.05)
    assert all(at + lasts < later for (at, lasts), (later, _) in pairwise(found))


def test_seeds_are_of_experiment_link_and_attempt() -> None:
    seeds = {
        link_seed(plan_seed(experiment, attempt), link)
        for experiment in ("scenario-1", "scenario-2")
        for attempt in (1, 2, 11)
        for link in ("air:uav1:up", "air:uav1:down")
    }
    assert len(seeds) == 12
    assert all(0 <= seed < 2**48 for seed in seeds)
    assert plan_seed("scenario-1", 1) == 96963143893435


@pytest.mark.parametrize(
    ("event", "said"),
    [
        (
            "link: air, at: 80s, change: {closed: true}",
            "own.yaml: events[0].at: '80s': expected a time before the end, 60s",
        ),
        (
            "link: 'air:uav9', at: 8s, change: {closed: true}",
            "own.yaml: events[0].link: 'air:uav9': no such link: expected one of wan:gs, backhaul:fog1, backhaul:fog2, "
            "air:uav1, air:uav2, air:uav3, air:uav4, air:uav5, air:uav6",
        ),
        (
            "link: satellite, at: 8s, change: {closed: true}",
            "own.yaml: events[0].link: 'satellite': expected a class, a link or one direction of it, as air, air:uav3, "
            "air:uav3:up",
        ),
        (
            "link: air, at: 8s, change: {closed: false}",
            "own.yaml: events[0].change.closed: False: expected true",
        ),
        (
            "link: air, at: 8s, change: {}",
            "own.yaml: events[0].change: {}: expected closed: true, or figures",
        ),
        (
            "link: air, at: 8, change: {closed: true}",
            "own.yaml: events[0].at: 8: expected a time with its unit (us, ms, s), as 25ms",
        ),
        (
            "link: air, change: {closed: true}",
            "own.yaml: events[0]: no time: expected one of at, every, bursts",
        ),
        (
            "link: air, at: 8s, every: 9s, change: {closed: true}",
            "own.yaml: events[0]: at and every: expected one of at, every, bursts",
        ),
        (
            "link: air, every: 9s, change: {closed: true}",
            "own.yaml: events[0].for: missing: expected how long it lasts, as 500ms",
        ),
        (
            "link: air, every: 9s, for: 9s, change: {closed: true}",
            "own.yaml: events[0].for: '9s': expected shorter than every, 9s",
        ),
        (
            "link: air, at: 8s, for: 0s, change: {closed: true}",
            "own.yaml: events[0].for: '0s': expected more than 0",
        ),
        (
            "link: air, every: 0s, for: 0s, change: {closed: true}",
            "own.yaml: events[0].every: '0s': expected more than 0",
        ),
        (
            "link: air, every: 2us, for: 1us, change: {closed: true}",
            "own.yaml: events[0].every: '2us': expected at least 100ms",
        ),
        (
            "link: air, bursts: {share: 90%, shortest: 1ms, longest: 1ms}, change: {closed: true}",
            "own.yaml: events[0].bursts.share: '90%': expected at most a burst every 100ms on average, or longer ones",
        ),
        (
            "link: air, bursts: {share: 0%, shortest: 100ms, longest: 200ms}, change: {closed: true}",
            "own.yaml: events[0].bursts.share: '0%': expected a share of time above 0%, at most 90%",
        ),
        (
            "link: air, bursts: {share: 5%, shortest: 300ms, longest: 200ms}, change: {closed: true}",
            "own.yaml: events[0].bursts.longest: '200ms': expected at least 300ms",
        ),
        (
            "link: air, bursts: {share: 5%, shortest: 1us, longest: 2us}, change: {closed: true}",
            "own.yaml: events[0].bursts.shortest: '1us': expected at least 1ms",
        ),
        (
            "link: air, bursts: {share: 5%, shortest: 10ms, longest: 20ms}, for: 1s, change: {closed: true}",
            "own.yaml: events[0].for: '1s': expected none beside bursts, which have shortest and longest",
        ),
        (
            "link: air, at: 8s, change: {jitter: 5ms}",
            "own.yaml: events[0].change.jitter: '5ms': expected at most the delay",
        ),
        (
            "link: air, at: 8s, change: {rate: 5kbit}",
            "own.yaml: events[0].change.rate: '5kbit': expected a queue beside it, as queue: 100 packets",
        ),
    ],
)
def test_an_event_that_cannot_be_is_one_line(tmp_path: Path, event: str, said: str) -> None:
    assert _refusal(tmp_path, event) == said


def test_one_direction_of_a_shared_medium_cannot_have_a_rate_of_its_own(tmp_path: Path) -> None:
    air = "{air: {shared: true, both: {rate: 64kbit, queue: 9 packets, source: s}}}"
    said = _refusal(tmp_path, "link: 'air:uav1:up', at: 8s, change: {rate: 5kbit}", air)
    assert said == ("own.yaml: events[0].change.rate: '5kbit': expected the whole link, its directions share a rate")


def test_a_change_that_breaks_what_is_not_changed_says_so(tmp_path: Path) -> None:
    said = _refusal(
        tmp_path,
        "link: air, at: 8s, change: {delay: 1ms}",
        "{air: {both: {delay: 9ms, jitter: 5ms, source: s}}}",
    )
    assert said == "own.yaml: events[0].change.jitter: not changed: expected at most the delay"


def test_an_event_can_lift_a_rate_with_its_queue(tmp_path: Path) -> None:
    air = "{air: {both: {rate: 64kbit, queue: 9 packets, source: s}}}"
    plan = _plan(tmp_path, "link: 'air:uav1:up', at: 8s, change: {rate: unlimited}", air)
    assert plan.events[0].change == {"rate_bps": None, "queue_packets": None}
