"""One station in control of a drone: first come, takeovers with epochs, and who gets what is freed (section 6)."""

from __future__ import annotations

from typing import Any

import pytest

from mqttxt.activator.leases import RESTORED_MS, Leases
from mqttxt.protocol.control import Control, Registration

A, B = ("a", 1), ("b", 2)


def registration(key: tuple[str, int], **fields: Any) -> Registration:
    return Registration(
        **{"name": key[0], "session": key[1], "nonce": 0, "lease_s": 30, "control": Control.WANT, **fields}
    )


def holders(leases: Leases, drones: tuple[int, ...] = (1, 2)) -> list[str | None]:
    held = [leases.holder(drone) for drone in drones]
    return [lease.key[0] if lease is not None else None for lease in held]


@pytest.fixture
def leases() -> Leases:
    """Of a fog with drone 1."""
    return Leases((1,))


def test_the_first_station_that_wants_control_has_it_and_a_watcher_never() -> None:
    leases = Leases((1, 2))
    assert leases.register(registration(("watcher", 9), control=Control.NONE), 0) == set()
    assert leases.register(registration(A), 0) == {1, 2}
    assert leases.register(registration(B), 0) == set()
    assert holders(leases) == ["a", "a"]
    assert leases.refusal(1, 1, 0, 0) is None
    assert leases.refusal(1, 2, 0, 0) == "not_in_control, a"
    assert leases.refusal(1, 9, 0, 0) == "not_in_control, a"
    assert leases.refusal(3, 1, 0, 0) == "not_in_control"


def test_a_takeover_raises_the_epoch_and_what_was_sent_under_the_old_one_is_refused() -> None:
    leases = Leases((1, 2))
    leases.register(registration(A), 0)
    leases.register(registration(B), 0)
    assert leases.register(registration(B, control=Control.TAKE, drones=(1,)), 0) == {1}
    assert holders(leases) == ["b", "a"]
    assert (leases.epoch(1), leases.epoch(2)) == (1, 0)
    assert leases.refusal(1, 2, 0, 0) == "not_in_control, b"
    assert leases.refusal(1, 2, 1, 0) is None
    assert leases.refusal(2, 1, 0, 0) is None


def test_a_free_drone_is_given_under_the_fogs_epoch_so_no_older_command_has_a_higher_one() -> None:
    leases = Leases((1, 2))
    leases.register(registration(A), 0)
    leases.register(registration(B, control=Control.TAKE, drones=(2,)), 0)
    leases.register(registration(B), 0)
    assert (holders(leases), leases.epoch(1)) == (["a", "b"], 0)
    assert leases.end(A, 10) == {1}
    assert (holders(leases), leases.epoch(1)) == (["b", "b"], 1)


def test_a_takeover_that_has_not_seen_the_newest_epoch_takes_nothing() -> None:
    leases = Leases((1, 2))
    leases.register(registration(A), 0)
    leases.register(registration(B, control=Control.TAKE, epoch=0), 0)
    stalled = registration(A, control=Control.TAKE, epoch=0)
    assert leases.register(stalled, 1000) == set()
    assert leases.register(registration(A, control=Control.TAKE, epoch=1), 1000) == {1, 2}
    assert leases.epoch(1) == 2


def test_a_takeover_of_one_drone_keeps_control_of_the_others() -> None:
    leases = Leases((1, 2, 3))
    leases.register(registration(A, drones=(1,)), 0)
    leases.register(registration(B), 0)
    assert holders(leases, (1, 2, 3)) == ["a", "b", "b"]
    leases.register(registration(B, control=Control.TAKE, drones=(1,)), 0)
    assert holders(leases, (1, 2, 3)) == ["b", "b", "b"]
    leases.register(registration(B), 0)
    assert holders(leases, (1, 2, 3)) == ["b", "b", "b"]


def test_a_lapsed_lease_ends_control(leases: Leases) -> None:
    leases.register(registration(A, lease_s=5), 0)
    leases.register(registration(B), 0)
    assert leases.tick(5000) == set()
    assert leases.tick(5001) == {1}
    assert holders(leases, (1,)) == ["b"]


def test_a_renewal_that_was_stalled_prolongs_only_to_what_its_sender_meant(leases: Leases) -> None:
    leases.register(registration(A, lease_s=30), 0)
    leases.register(registration(A, lease_s=30, until_ms=35_000), 20_000)
    leases.tick(35_001)
    assert holders(leases, (1,)) == [None]


def test_a_drone_that_appears_later_is_controlled_too() -> None:
    leases = Leases()
    leases.register(registration(A), 0)
    assert leases.add(7, 0) == {7}
    assert leases.add(7, 0) == set()


def test_after_a_restart_a_drone_is_kept_for_its_station_and_the_epoch_goes_on(leases: Leases) -> None:
    leases.restore(1, A, 4, 0)
    assert leases.register(registration(B), 10) == set()
    assert leases.register(registration(A), 20) == {1}
    assert (holders(leases, (1,)), leases.epoch(1)) == (["a"], 4)


def test_a_takeover_after_a_restart_takes_what_is_kept_for_another_station() -> None:
    leases = Leases((1, 2))
    leases.restore(1, A, 4, 0)
    leases.register(registration(B), 10)
    assert leases.register(registration(B, control=Control.TAKE, drones=(1,), epoch=4), 20) == {1}
    assert (holders(leases), leases.epoch(1)) == (["b", "b"], 5)
    assert leases.register(registration(A), 30) == set()


def test_a_takeover_after_a_restart_takes_a_drone_that_has_not_been_seen_yet(leases: Leases) -> None:
    """It is not one of the configured ones, and only its record names it so far."""
    leases.restore(7, A, 4, 0)
    leases.register(registration(B), 10)
    assert leases.register(registration(B, control=Control.TAKE, epoch=4), 20) == {7}
    leases.register(registration(A), 30)
    leases.add(7, 40)
    assert (holders(leases, (7,)), leases.epoch(7)) == (["b"], 5)


def test_a_drone_that_nobody_comes_back_for_is_given_away(leases: Leases) -> None:
    leases.restore(1, A, 4, 0)
    leases.register(registration(B), 10)
    assert leases.tick(RESTORED_MS) == set()
    assert leases.tick(RESTORED_MS + 1) == {1}
    assert holders(leases, (1,)) == ["b"]


def test_want_of_topics_and_bundles_is_of_all_stations() -> None:
    leases = Leases()
    assert not leases
    leases.register(registration(A, bundles=True), 0)
    assert (leases.want_topics, leases.want_bundles) == (False, True)
    leases.register(registration(B), 0)
    assert (leases.want_topics, leases.want_bundles) == (True, True)


def test_a_lapsed_lease_gives_no_control_before_the_next_tick_either(leases: Leases) -> None:
    """A process that stood still reads what its sockets hold before it ticks."""
    leases.register(registration(A, lease_s=5), 0)
    assert leases.refusal(1, 1, 0, 5000) is None
    assert leases.refusal(1, 1, 0, 5001) == "not_in_control"


def test_a_registration_that_comes_after_its_end_takes_nothing(leases: Leases) -> None:
    leases.register(registration(A), 0)
    late = registration(B, control=Control.TAKE, until_ms=9_999)
    assert leases.register(late, 10_000) == set()
    assert (holders(leases, (1,)), leases.epoch(1), B in leases) == (["a"], 0, False)


def test_an_end_that_is_too_far_does_not_make_a_registration_one_of_the_future(leases: Leases) -> None:
    """Offboard goes on for 3 s behind the moment at which the newest registration was sent."""
    leases.register(registration(A, lease_s=30, until_ms=10**9), 1000)
    lease = leases.holder(1)
    assert lease is not None
    assert (lease.sent_ms, lease.until_ms) == (1000, 31_000)


def test_a_station_that_names_no_drones_at_all_gets_none() -> None:
    leases = Leases((1, 2))
    leases.register(registration(A), 0)
    assert leases.register(registration(B, control=Control.TAKE, drones=()), 0) == set()
    leases.end(A, 0)
    assert holders(leases) == [None, None]


def test_a_watcher_that_takes_one_drone_gets_no_other_one() -> None:
    leases = Leases((1, 2))
    leases.register(registration(A, drones=(1,)), 0)
    leases.register(registration(B, control=Control.NONE), 0)
    assert leases.register(registration(B, control=Control.TAKE, drones=(1,)), 0) == {1}
    assert holders(leases) == ["b", None]
