"""What commands and words cost, on frames made by hand."""

from __future__ import annotations

from dataclasses import astuple

from tests.bench.words import Frame, Message, share_acknowledgements, share_headers

PUBLISH, PUBACK = 3, 4
DOWN, UP = "fog1:1883>uav1:50000", "uav1:50000>fog1:1883"
_numbers = iter(range(1000))


def message(size: int, payload: int = 0, packet: int = PUBLISH, mid: int = 0) -> Message:
    return Message(next(_numbers), ("air", "x"), size, payload, packet, mid)


def frame(flow: str, at: int, *messages: Message, is_copy: bool = False, left: bool = True) -> Frame:
    """A frame with 60 bytes of headers, on its link for 5 ns."""
    size = 60 + sum(each.size for each in messages)
    return Frame(flow, at, at + 5 if left else None, size, 60, [*messages], is_copy)


def shared(*frames: Frame) -> None:
    share_headers(frames)
    share_acknowledgements(frames)


def test_a_frames_headers_are_shared_by_bytes_and_a_copy_costs_all_of_itself() -> None:
    word, state = message(40, 18), message(80, 60)
    shared(frame(UP, 0, word, state), frame(UP, 300, word, state, is_copy=True))
    assert astuple(word.cost) == (1, 20 + 60, 22, 18, 0, 0)
    assert astuple(state.cost) == (1, 40 + 120, 20, 60, 0, 0)


def test_a_bare_acknowledgement_belongs_to_what_had_come_and_was_not_acknowledged() -> None:
    first, second, lost, late, answer = (message(30) for _ in range(5))
    shared(
        frame(DOWN, 0, first),
        frame(UP, 10, answer),  # takes the acknowledgement of the first along
        frame(DOWN, 20, second),
        frame(DOWN, 21, lost, left=False),
        frame(DOWN, 28, late),
        frame(UP, 30),
        frame(UP, 40),
    )
    assert [each.cost.tcp_acks for each in (first, second, lost, late)] == [0, 60, 0, 60]
    assert answer.cost.tcp_acks == 0  # nothing came back but what was sent before it had come


def test_a_puback_with_its_own_acknowledgement_belongs_to_its_publish() -> None:
    command, other = message(50, mid=7), message(50, mid=8)
    puback = message(4, packet=PUBACK, mid=7)
    shared(frame(DOWN, 0, command), frame(DOWN, 1, other), frame(UP, 10, puback), frame(DOWN, 20))
    assert command.cost.pubacks == 64 + 60
    assert other.cost.pubacks == 0


def test_one_puback_of_a_datagram_belongs_to_all_of_its_messages() -> None:
    one, other, puback = message(30, mid=7), message(40, mid=7), message(8, packet=PUBACK, mid=7)
    shared(frame(UP, 0, one, other), frame(DOWN, 10, puback))
    assert one.cost.pubacks == other.cost.pubacks == (8 + 60) / 2
