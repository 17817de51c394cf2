"""Which bare acknowledgements could have ridden on data of the same end."""

from __future__ import annotations

from tests.bench.lean_tcp import Frame, followed

MS = 1_000_000


def bare(at_ms: int) -> Frame:
    return Frame(at_ms * MS, 66, 0)


def data(at_ms: int) -> Frame:
    return Frame(at_ms * MS, 100, 34)


def test_an_acknowledgement_could_wait_for_data_within_40_ms() -> None:
    assert followed([bare(0), data(40)]) == 1
    assert followed([bare(0), data(41)]) == 0
    assert followed([bare(0), bare(10), data(30), bare(35), data(1_000), bare(1_001)]) == 2


def test_without_data_there_is_nothing_to_wait_for() -> None:
    assert followed([]) == 0
    assert followed([bare(0), bare(1)]) == 0
