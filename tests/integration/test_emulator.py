"""The emulator with real packets and no more rights than net has: what is planned arrives, and is counted."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from statistics import median, quantiles
from typing import Any

import pytest

from tests.rigs.shaped_link import DOWN, SUBNETS, UP, Emulator, ShapedLink, plan_of

pytestmark = [
    pytest.mark.integration,
    pytest.mark.alone,
    pytest.mark.timeout(120),
    pytest.mark.soak(
        "services/net/src", "tests/rigs/shaped_link.py", "tests/rigs/shaped_nodes.py", "tests/rigs/link_probe.py"
    ),
]
WIDE_999 = 3.29
"""Standard deviations on each side that hold 99.9 % of a normal distribution."""
LATE_MS = 2.0
"""What a busy machine may add to a delay in the median."""


def within(count: int, frames: int, share: float) -> bool:
    """Whether a count is in the 99.9 % interval of the binomial distribution."""
    return abs(count - frames * share) <= WIDE_999 * math.sqrt(frames * share * (1 - share)) + 1


def counts(emulator: Emulator) -> dict[str, int]:
    """What the way up counted, at the end of a run that stands."""
    content = emulator.end()
    found: dict[str, int] = content["links"][UP]
    assert found["overload"] == 0, content["void"]
    return found


def test_a_delay_is_never_cut_short_and_hardly_exceeded(link: ShapedLink) -> None:
    with link.shaping({"delay_us": 50_000}) as emulator:
        rows = emulator.flow(400, 200, 100)
        found = counts(emulator)
    delays_ms = [row.delay_ms for row in rows]
    assert found["entered"] == found["left"] == len(rows) == 400
    assert found["entered_bytes"] == 400 * 114
    assert min(delays_ms) >= 50.0
    assert median(delays_ms) <= 50.0 + LATE_MS


@pytest.mark.parametrize(("distribution", "half"), [("normal", 2 * 0.674), ("uniform", 2 * 0.5)])
def test_jitter_spreads_the_delay_and_keeps_the_order(link: ShapedLink, distribution: str, half: float) -> None:
    """`half` is what lies between the quartiles, in jitters: a busy machine's few late packets do not change it."""
    slots = 3.0 / 0.020  # seconds of the flow, by the length of the jitter's slots
    with link.shaping({"delay_us": 40_000, "jitter_us": 4000, "distribution": distribution}) as emulator:
        rows = emulator.flow(1500, 500, 100)
    delays_ms = [row.delay_ms for row in rows]
    assert [row.number for row in rows] == list(range(1500))
    assert median(delays_ms) == pytest.approx(40.0, abs=1.25 * WIDE_999 * 4.0 / math.sqrt(slots) + LATE_MS)
    low, _, high = quantiles(delays_ms, n=4)
    assert high - low == pytest.approx(4.0 * half, rel=0.35)


def test_reordering_jitter_lets_datagrams_overtake(link: ShapedLink) -> None:
    with link.shaping({"delay_us": 40_000, "jitter_us": 10_000, "reordering": True}) as emulator:
        rows = emulator.flow(1000, 500, 100)
    numbers = [row.number for row in rows]
    assert sorted(numbers) == list(range(1000))
    assert sum(one > other for one, other in itertools.pairwise(numbers)) > 100


def test_loss_is_as_planned_and_counted(link: ShapedLink) -> None:
    with link.shaping({"loss": 0.05, "delay_us": 10_000}) as emulator:
        rows = emulator.flow(5000, 2500, 100)
        found = counts(emulator)
    assert within(found["random"], 5000, 0.05)
    assert found["left"] == len(rows) == 5000 - found["random"]


def test_a_rate_is_held_and_its_queue_drops_the_rest(link: ShapedLink) -> None:
    planned = {"rate_bps": 1_000_000, "queue_packets": 10, "delay_us": 100_000}
    with link.shaping(planned) as emulator:
        rows = emulator.flow(1500, 1000, 236)  # 250 bytes with Ethernet's head: 2 ms each
        found = counts(emulator)
    assert found["left"] + found["queue"] == 1500
    assert len(rows) == found["left"]
    span_s = (rows[-1].received_ns - rows[0].received_ns) / 1e9
    assert (len(rows) - 1) * 2000 / span_s == pytest.approx(1_000_000, rel=0.03)
    assert median(row.delay_ms for row in rows) == pytest.approx(100 + 10 * 2, abs=LATE_MS + 2)


def test_both_ways_share_a_rate_and_the_way_back_takes_its_turn(link: ShapedLink) -> None:
    shared = {"rate_bps": 200_000, "queue_packets": 200}
    with link.shaping({**shared, "shared_with": DOWN}, down={**shared, "shared_with": UP}) as emulator:
        emulator.send(200, 0, 986)  # 40 ms each: eight seconds
        rows = emulator.flow_back(20, 10, 111)  # 5 ms each
    assert len(rows) == 20
    assert 5 + 5 < median(row.delay_ms for row in rows) < 5 + 40 + 10, "one frame of the other way before it, not all"


def test_copies_and_turned_bits_arrive_as_often_as_counted(link: ShapedLink) -> None:
    with link.shaping({"duplicate": 0.1, "corrupt": 0.05, "delay_us": 20_000}) as emulator:
        rows = emulator.flow(3000, 1000, 1028)
        found = counts(emulator)
    assert within(found["duplicated"], 3000, 0.1)
    assert within(found["corrupted"], 3000 + found["duplicated"], 0.05)
    assert found["left"] + found["refused"] == 3000 + found["duplicated"]
    sound = [row for row in rows if row.sound]
    # A bit turned within the 28 bytes of headers, of 1028, keeps the datagram from its receiver, or goes unnoticed.
    assert 0 <= len(sound) - (3000 + found["duplicated"] - found["corrupted"]) <= 12
    assert len(rows) - len(sound) == pytest.approx(found["corrupted"], abs=12)
    assert sum(count == 2 for count in Counter(row.number for row in sound).values()) > 0.8 * found["duplicated"]
    assert median(row.delay_ms for row in sound) == pytest.approx(20.0, abs=LATE_MS)


def test_a_share_of_datagrams_skips_its_delay(link: ShapedLink) -> None:
    with link.shaping({"reorder": 0.2, "delay_us": 50_000}) as emulator:
        rows = emulator.flow(1000, 500, 100)
        found = counts(emulator)
    assert within(found["reordered"], 1000, 0.2)
    assert sum(row.delay_ms < 50.0 for row in rows) == found["reordered"]


def test_an_event_closes_the_link_for_its_time(link: ShapedLink) -> None:
    closing = {"at_s": 2.0, "for_s": 1.0, "link": UP, "change": {"closed": True}}
    with link.shaping({}, [closing]) as emulator:
        rows = emulator.flow(2000, 400, 100, silence_s=3.0)
        found = counts(emulator)
    assert found["closed"] == 2000 - len(rows) > 0
    (outage,) = [
        (after.sent_ns - before.sent_ns) / 1e9
        for before, after in itertools.pairwise(rows)
        if after.number > before.number + 1
    ]
    assert outage == pytest.approx(1.0, abs=0.1)


def test_nothing_passes_once_the_emulator_has_ended(link: ShapedLink) -> None:
    with link.shaping({}) as emulator:
        assert len(emulator.flow(5, 100, 100, silence_s=0.5)) == 5
        emulator.end()
        ping = ["ping", "-c", "2", "-i", "0.2", "-W", "1", f"{SUBNETS['cloud']}.3"]
        code, said = link.nodes["gs"].exec_run(ping)
    assert code == 1, said.decode()


def test_what_it_does_not_keep_up_with_is_counted_and_voids_the_run(link: ShapedLink) -> None:
    with link.shaping({}) as emulator:
        emulator.signal("STOP")
        emulator.send(150_000, 0, 44)
        emulator.signal("CONT")
        content = emulator.end()
    found = content["links"][UP]
    assert found["overload"] > 0
    assert content["void"].startswith("the emulator did not keep up: packets lost to overload: wan:gs:up ")
    assert content["links"][DOWN]["overload"] == 0


@pytest.mark.parametrize(
    ("plan", "said"),
    [
        (plan_of({"loss": 1.5}), "plan.json: links.wan:gs:up.loss 1.5: expected a share from 0 to 1"),
        (
            {**plan_of({}), "links": {"air:uav1:up": {}}},
            "links 'air:uav1:up': expected CLASS:NODE:up or CLASS:NODE:down",
        ),
        ({**plan_of({}), "links": {UP: {}}}, "links: none from cloud to gs; expected one each way"),
    ],
)
def test_a_plan_that_cannot_be_carried_out_is_refused_in_one_line(link: ShapedLink, plan: Any, said: str) -> None:
    code, words = link.shape(plan)
    assert code == 2
    assert said in words
    assert len(words.splitlines()) == 1


def test_a_counters_file_that_cannot_be_written_is_named(link: ShapedLink) -> None:
    code, words = link.shape(plan_of({}), counters="/nowhere/counters.json")
    assert code == 1
    assert words == (
        "net: --counters /nowhere/counters.json: No such file or directory; expected a file that can be written\n"
    )


def test_without_the_right_to_it_says_so_in_one_line(link: ShapedLink) -> None:
    link.output("net", ["mkdir", "-p", "-m", "777", "/tmp/shaping"])
    code, words = link.shape(plan_of({}), user="1000:1000")
    assert code == 1
    assert "expected CAP_NET_ADMIN" in words
    assert len(words.splitlines()) == 1
