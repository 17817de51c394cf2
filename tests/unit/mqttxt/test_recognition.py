"""Whose autopilot is on the link: a stray heartbeat of another system ends nobody."""

from __future__ import annotations

from mqttxt.drone.recognition import GAP_MS, PATIENCE_MS, Recognition


def beats(recognition: Recognition, system_id: int, start_ms: int, end_ms: int, gap_ms: int = 1000) -> list[int | None]:
    return [recognition.on_heartbeat(system_id, now) for now in range(start_ms, end_ms, gap_ms)]


def test_the_own_autopilot_is_known_at_once() -> None:
    assert Recognition(7).on_heartbeat(7, 0) == 7


def test_a_stray_heartbeat_of_another_system_says_nothing() -> None:
    recognition = Recognition(7)
    assert recognition.on_heartbeat(9, 0) is None
    assert recognition.on_heartbeat(9, PATIENCE_MS + 1) is None
    assert recognition.on_heartbeat(7, PATIENCE_MS + 2) == 7


def test_another_autopilot_whose_heartbeat_keeps_coming_is_the_links() -> None:
    said = beats(Recognition(7), 9, 0, PATIENCE_MS + 1)
    assert (set(said[:-1]), said[-1]) == ({None}, 9)


def test_one_that_comes_and_goes_is_not() -> None:
    assert set(beats(Recognition(7), 9, 0, 10 * PATIENCE_MS, GAP_MS + 1)) == {None}


def test_others_share_a_link_with_the_own_system() -> None:
    recognition = Recognition(7)
    for start in range(0, 5 * PATIENCE_MS, PATIENCE_MS - 1000):
        assert set(beats(recognition, 9, start, start + PATIENCE_MS - 1000)) == {None}
        recognition.on_own()
