"""When an unanswered message is sent again."""

from __future__ import annotations

from mqttxt.core.settings import Retry


def test_pauses_double_from_two_to_sixteen_seconds() -> None:
    retry = Retry(0)
    assert [now for now in range(0, 70_000, 1000) if retry.is_due(now)] == [
        0,
        2000,
        6000,
        14_000,
        30_000,
        46_000,
        62_000,
    ]


def test_at_qos_1_the_transport_repeats_until_the_deadline() -> None:
    assert not Retry.of(1, 0, 5000).is_due(4999)
    assert Retry.of(1, 0, 5000).is_due(5000)
    at_qos_0 = Retry.of(0, 0, 5000)
    assert [now for now in range(0, 40_000, 1000) if at_qos_0.is_due(now)] == [2000, 6000, 14_000, 30_000]


def test_an_answered_command_is_asked_for_rarely_at_qos_0_and_not_at_all_at_qos_1() -> None:
    assert Retry.after_word(1, 0) is None
    retry = Retry.after_word(0, 0)
    assert retry is not None
    assert [now for now in range(0, 50_000, 1000) if retry.is_due(now)] == [16_000, 32_000, 48_000]
