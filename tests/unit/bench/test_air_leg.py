"""How old the newest state gets, on messages made by hand."""

from __future__ import annotations

from tests.bench.air_leg import oldest_ns


def test_the_newest_is_oldest_just_before_the_next_arrives() -> None:
    assert oldest_ns([(0, 40), (1000, 1040), (2000, 2700)]) == 2700 - 1000


def test_what_an_older_one_tells_later_makes_nothing_younger() -> None:
    assert oldest_ns([(100, 140), (1100, 3000), (2100, 2140), (3100, 3140)]) == 2140 - 100


def test_one_alone_has_no_next() -> None:
    assert oldest_ns([(100, 140)]) == 0
