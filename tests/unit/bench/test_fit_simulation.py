"""The simulation of a profile's rates, against answers worked out by hand and against the emulator's own link."""

from __future__ import annotations

import pytest

from net.emulator.link import PASS, EmulatedLink
from net.emulator.plan import Settings
from net.link_plan import LinkPlan
from tests.bench.fit_calls import ANSWER, unanswered, with_calls
from tests.bench.fit_search import lowest
from tests.bench.fit_simulation import DOWN, Offered, cross, delay, losses, run, send
from tests.bench.fit_streams import Frame, exact, load_of

MS = 1_000_000
FLEET = {1: (1, 2), 2: (4,)}
NAMES = ("air:uav1", "air:uav2", "air:uav4", "backhaul:fog1", "backhaul:fog2", "wan:gs")
FREE = {f"{name}:{way}": LinkPlan() for name in NAMES for way in ("up", "down")}


def test_a_frame_leaves_when_its_last_bit_is_sent_after_the_one_before() -> None:
    frames = [(0, 100, 0), (0, 50, 1), (20 * MS, 100, 2)]
    assert send(frames, 80_000, None) == [(10 * MS, 100, 0), (15 * MS, 50, 1), (30 * MS, 100, 2)]


def test_the_queue_holds_so_many_frames_with_the_one_being_sent() -> None:
    frames = [(0, 100, number) for number in range(5)]
    assert [number for _, _, number in send(frames, 80_000, 2)] == [0, 1]


def test_a_frame_that_comes_as_another_leaves_finds_its_place_free() -> None:
    at_once, then = [(0, 100, 0), (0, 100, 1)], (10 * MS, 100, 2)
    assert send([*at_once, then], 80_000, 2)[-1] == (30 * MS, 100, 2)
    assert len(send([*at_once, (10 * MS - 1, 100, 2)], 80_000, 2)) == 2


def test_what_is_on_its_way_does_not_fill_the_queue() -> None:
    frames = [(number * 10 * MS, 100, number) for number in range(100)]
    crossed = cross("air:uav1:up", LinkPlan(rate_bps=80_000, queue_packets=1, delay_us=500_000), frames, 1)
    assert (crossed.queue, len(crossed.left)) == (0, 100)
    assert crossed.left[0][0] == 510 * MS


def test_an_overfilled_queue_takes_the_first_of_each_burst_and_drops_its_last() -> None:
    """Three frames every 10 ms, of which two can be sent: once the queue is full, the third is always the one lost."""
    frames = [(tick * 10 * MS, 50, 3 * tick + place) for tick in range(100) for place in range(3)]
    kept = {number for _, _, number in send(frames, 80_000, 4)}
    lost = sorted(set(range(300)) - kept)
    assert all(number % 3 == 2 for number in lost)
    assert len(lost) == 98, "two of the hundred that are too many wait in the queue"


def test_jitter_holds_frames_back_rather_than_let_them_overtake() -> None:
    frames = [(0, 100, 0), (1 * MS, 100, 1)]
    early = {0: 5 * MS, 1 * MS: -5 * MS}
    assert [t for t, _, _ in delay(frames, 10 * MS, early.__getitem__, True)] == [15 * MS, 15 * MS]
    assert [number for _, _, number in delay(frames, 10 * MS, early.__getitem__, False)] == [1, 0]


def test_it_keeps_and_times_the_frames_that_the_emulator_keeps() -> None:
    frames = [(frame.t_ns, frame.size, number) for number, frame in enumerate(exact("px4-onboard", 5))]
    figures = {"rate_bps": 318_000, "queue_packets": 60, "delay_us": 200_000, "jitter_us": 20_000}
    link = EmulatedLink("air:uav1:up", Settings(**figures), 7)
    fates = [(link.arrive(now_ns, size), size, number) for now_ns, size, number in frames]
    crossed = cross("air:uav1:up", LinkPlan(**figures), frames, 7)
    assert crossed.left == [(due_ns, size, number) for (due_ns, fate), size, number in fates if fate == PASS]
    assert crossed.queue == link.counters.queue > 0


def test_losses_are_counted_end_to_end_and_over_all_links() -> None:
    """Of 4 frames one is dropped on the air, of the 3 others one on the wan: 2 of 4, and 2 of the 10 that entered."""
    stream = tuple(Frame(t_ns, 100, kind) for t_ns, kind in ((0, "A"), (0, "A"), (0, "B"), (100 * MS, "B")))
    air = LinkPlan(rate_bps=800_000, queue_packets=2)
    wan = LinkPlan(rate_bps=80_000, queue_packets=1)
    offered = Offered({1: stream}, FLEET)
    found = losses(offered, run(offered, {**FREE, "air:uav1:up": air, DOWN: wan}, 1))
    assert (found.sent, found.end_to_end, found.wire) == (4, 0.5, 2 / 10)
    assert found.kinds == {"A": 0.5, "B": 0.5}
    assert found.drones == {1: 0.5}


def test_drones_meet_where_their_links_do() -> None:
    streams = {drone: (Frame(0, 100, "A"),) for drone in (1, 2, 4)}
    offered = Offered(streams, FLEET)
    shared = LinkPlan(rate_bps=80_000, queue_packets=1)
    assert losses(offered, run(offered, {**FREE, "air:uav1:up": shared}, 1)).end_to_end == 0
    assert losses(offered, run(offered, {**FREE, "backhaul:fog1:up": shared}, 1)).end_to_end == pytest.approx(1 / 3)
    assert losses(offered, run(offered, {**FREE, DOWN: shared}, 1)).end_to_end == pytest.approx(2 / 3)


def test_frames_of_the_begin_do_not_count() -> None:
    stream = tuple(Frame(t_ns, 100, "A") for t_ns in (0, 0, 100 * MS))
    offered = Offered({1: stream}, FLEET)
    crossed = run(offered, {**FREE, "air:uav1:up": LinkPlan(rate_bps=80_000, queue_packets=1)}, 1)
    assert losses(offered, crossed, 50 * MS).sent == 1
    assert losses(offered, crossed, 50 * MS).end_to_end == 0


@pytest.mark.parametrize(("delay_ms", "lost"), [(100, 0.0), (990, 0.0), (1010, 1.0)])
def test_a_call_is_given_up_after_two_seconds(delay_ms: int, lost: float) -> None:
    stream = tuple(Frame(number * 100 * MS, 100, "A") for number in range(200))
    links = {
        **FREE,
        "air:uav1:up": LinkPlan(delay_us=delay_ms * 1000),
        "air:uav1:down": LinkPlan(delay_us=delay_ms * 1000),
    }
    calls = with_calls({1: stream}, links, 1.0, 0, 3)
    offered = Offered(calls.streams, FLEET)
    assert calls.arrived == calls.begun > 10
    assert sum(frame.kind == ANSWER for frame in calls.streams[1]) == 4 * calls.begun
    assert unanswered(calls, offered, run(offered, links, 3)) == lost


def test_the_lowest_rate_is_found_between_its_bounds_and_in_whole_steps() -> None:
    tried = []

    def share(rate: int) -> float:
        tried.append(rate)
        return 1 - rate / 1000

    assert lowest(share, 0.25, (100, 1000), 10) == 750
    assert lowest(share, 0.255, (100, 1000), 10) == 750
    assert len(tried) < 20


@pytest.mark.long
def test_exact_streams_are_the_stand_ins_rates_in_flight() -> None:
    onboard, gcs = (load_of(exact(chosen, 20)) for chosen in ("px4-onboard", "px4-gcs"))
    assert onboard.frames_s == pytest.approx(420.1, abs=0.5)
    assert onboard.kbit_s == pytest.approx(341.8, abs=1.0)
    assert gcs.frames_s == pytest.approx(372.7, abs=0.5)
    assert gcs.kbit_s == pytest.approx(262.0, abs=1.0)
