"""Two links that share a rate send one frame at a time, in turns where both have some."""

from __future__ import annotations

from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from net.emulator.link import DROP, PASS, WAIT, EmulatedLink
from net.emulator.plan import Settings
from net.emulator.turns import QUANTUM_BYTES, Turns

MS = 1_000_000
FRAME = 125
"""Bytes that take a millisecond at 1 Mbit/s."""


def pair(**settings: int) -> tuple[Turns, EmulatedLink, EmulatedLink]:
    turns = Turns()
    planned = Settings(rate_bps=1_000_000, **settings)
    up, down = (EmulatedLink(name, planned, 1, turns) for name in ("air:uav1:up", "air:uav1:down"))
    return turns, up, down


def test_a_frame_waits_for_one_of_the_other_link_not_for_its_whole_queue() -> None:
    turns, up, down = pair()
    assert [up.arrive(0, FRAME)[1] for _ in range(5)] == [WAIT] * 5
    assert list(turns.advance(0)) == [(up, 1 * MS, PASS)]
    down.arrive(MS // 2, FRAME)
    assert turns.next_ns == 1 * MS
    assert list(turns.advance(3 * MS)) == [(down, 2 * MS, PASS), (up, 3 * MS, PASS), (up, 4 * MS, PASS)]


def test_what_is_said_late_is_the_same_as_what_is_said_in_time() -> None:
    found = []
    for step in (1, 7 * MS):
        turns, up, down = pair(delay_us=3000)
        up.arrive(0, FRAME)
        up.arrive(1, 2 * FRAME)
        down.arrive(2, FRAME)
        found.append(
            [sent for now in range(0, 7 * MS + 1, step * (MS if step == 1 else 1)) for sent in turns.advance(now)]
        )
    assert [due for _, due, _ in found[0]] == [due for _, due, _ in found[1]] == [4 * MS, 5 * MS, 7 * MS]


def test_each_link_has_a_queue_of_its_own_which_holds_the_frame_being_sent() -> None:
    turns, up, down = pair(queue_packets=2)
    assert [up.arrive(0, FRAME)[1] for _ in range(3)] == [WAIT, WAIT, DROP]
    assert down.arrive(0, FRAME)[1] == WAIT
    assert [due for _, due, _ in turns.advance(0)] == [1 * MS]
    assert up.arrive(0, FRAME)[1] == DROP, "one is being sent, one waits"
    assert up.counters.queue == 2
    assert down.counters.queue == 0


@pytest.mark.parametrize(("large", "small"), [(1514, 1514), (1000, 125), (1514, 60), (300, 250)])
def test_two_overfull_links_have_the_same_bytes_whatever_their_frames(large: int, small: int) -> None:
    turns, up, down = pair()
    for _ in range(600):
        up.arrive(0, large)
        down.arrive(0, small)
    until = 200 * small * 8000
    sent = Counter[EmulatedLink]()
    for link, _, _ in turns.advance(until):
        sent[link] += large if link is up else small
    assert abs(sent[up] - sent[down]) <= 2 * QUANTUM_BYTES


def test_a_link_that_was_silent_has_saved_nothing() -> None:
    turns, up, down = pair()
    for _ in range(40):
        up.arrive(0, 1000)
    assert len(list(turns.advance(20 * 8 * MS - 1))) == 20
    for _ in range(40):
        down.arrive(20 * 8 * MS - 1, 1000)
    after = [link for link, _, _ in turns.advance(40 * 8 * MS - 1)]
    assert after.count(down) == pytest.approx(10, abs=1)


@given(frames=st.lists(st.tuples(st.integers(0, 3 * MS), st.booleans(), st.integers(34, 1514)), max_size=60))
def test_never_two_frames_at_a_time_and_each_link_in_order(frames: list[tuple[int, bool, int]]) -> None:
    turns, up, down = pair()
    now, sent, sizes = 0, [], {up: [], down: []}  # type: ignore[var-annotated]
    for wait, is_up, size in frames:
        now += wait
        sent += list(turns.advance(now))
        link = up if is_up else down
        link.arrive(now, size)
        sizes[link].append(size)
    sent += list(turns.advance(now + 10_000 * MS))
    assert len(sent) == len(frames)
    before = 0
    for link, due, fate in sent:
        assert fate == PASS
        before += sizes[link].pop(0) * 8000
        assert due >= before
        before = due
