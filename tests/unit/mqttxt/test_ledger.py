"""The ledger: duplicates are found, contents compared, and a full one denies (section 5)."""

from __future__ import annotations

import pytest

from mqttxt.core.ledger import CAPACITY, FOG_CAPACITY, KEEP_MS, Admission, Ledger, Share
from mqttxt.protocol.commands import Arm, Disarm, Land
from mqttxt.protocol.messages import CommandId

ONE, TWO = CommandId(1, 1), CommandId(1, 2)


@pytest.fixture
def ledger() -> Ledger[None]:
    return Ledger()


def test_an_id_is_new_once_and_then_a_duplicate_or_a_conflict(ledger: Ledger[None]) -> None:
    assert ledger.examine(ONE, Arm(), 5000, 0) is Admission.NEW
    ledger.enter(ONE, Arm(), None, 5000)
    assert ledger.examine(ONE, Arm(), 5000, 10) is Admission.DUPLICATE
    assert ledger.examine(ONE, Disarm(), 5000, 10) is Admission.CONFLICT
    assert ledger.examine(CommandId(2, 1), Arm(), 5000, 10) is Admission.NEW


def test_an_outcome_is_kept_for_ten_minutes_after_the_deadline(ledger: Ledger[None]) -> None:
    ledger.close(ledger.enter(ONE, Arm(), None, 5000), 100)
    assert ledger.examine(ONE, Arm(), 5000, 5000 + KEEP_MS) is Admission.DUPLICATE
    assert ledger.examine(TWO, Arm(), 5000, 5000 + KEEP_MS) is Admission.NEW
    assert ledger.get(ONE) is not None
    ledger.examine(TWO, Arm(), 5000, 5001 + KEEP_MS)
    assert ledger.get(ONE) is None


def test_an_outcome_that_was_closed_twice_is_kept_for_ten_minutes_after_the_second_time(ledger: Ledger[None]) -> None:
    entry = ledger.enter(ONE, Arm(), None, 0)
    for closed_ms in (0, 100, 100):
        ledger.close(entry, closed_ms)
    assert ledger.examine(TWO, Arm(), 5000, 100 + KEEP_MS) is Admission.NEW
    assert ledger.get(ONE) is entry
    ledger.examine(TWO, Arm(), 5000, 101 + KEEP_MS)
    assert ledger.get(ONE) is None
    entry = ledger.enter(ONE, Arm(), None, 0)
    ledger.examine(TWO, Arm(), 5000, 300 + KEEP_MS)
    assert ledger.get(ONE) is entry, "it is open"


def test_only_what_is_not_newer_than_a_forgotten_id_may_have_been_forgotten(ledger: Ledger[None]) -> None:
    ledger.close(ledger.enter(TWO, Arm(), None, 0), 0)
    assert not ledger.may_have_forgotten(ONE)
    ledger.examine(ONE, Arm(), 5000, KEEP_MS + 1)
    asked = (ONE, TWO, CommandId(1, 3), CommandId(2, 1))
    assert [ledger.may_have_forgotten(each) for each in asked] == [True, True, False, False]


def test_a_ledger_notes_the_forgotten_of_so_many_sessions_as_it_has_places() -> None:
    ledger: Ledger[None] = Ledger(capacity=4, keep_ms=0)
    for session in (1, 2, 3, 1, 4, 5):
        ledger.close(ledger.enter(CommandId(session, 1), Arm(), None, 0), 0)
        ledger.examine(CommandId(9, 9), Arm(), 1, 1)
    assert [ledger.may_have_forgotten(CommandId(session, 1)) for session in range(1, 6)] == [True, False, *[True] * 3]


def test_an_open_entry_is_never_forgotten(ledger: Ledger[None]) -> None:
    ledger.enter(ONE, Arm(), None, 5000)
    ledger.examine(TWO, Arm(), 5000, 100 * KEEP_MS)
    assert [entry.id for entry in ledger.open_entries()] == [ONE]


def test_a_full_ledger_denies_and_what_it_denied_is_not_executed_when_there_is_room() -> None:
    ledger: Ledger[None] = Ledger(capacity=1, keep_ms=10)
    ledger.close(ledger.enter(ONE, Arm(), None, 100), 0)
    assert ledger.examine(TWO, Arm(), 5000, 50) is Admission.FULL
    assert ledger.get(ONE) is not None, "it never evicts"
    assert ledger.examine(TWO, Arm(), 5000, 3000) is Admission.FULL
    assert ledger.examine(CommandId(1, 3), Arm(), 9000, 5001) is Admission.NEW


def test_a_denial_of_a_nearer_deadline_does_not_free_what_was_denied_for_longer() -> None:
    """Else a command could be executed after it was denied."""
    ledger: Ledger[None] = Ledger(capacity=4, keep_ms=0)
    later = [CommandId(1, seq) for seq in (3, 4)]
    first = ledger.enter(ONE, Arm(), None, 0)
    second = ledger.enter(TWO, Arm(), None, 0)
    assert ledger.examine(later[0], Arm(), 50_000, 0) is Admission.FULL
    assert ledger.examine(later[1], Arm(), 5000, 0) is Admission.FULL
    for entry in (first, second):
        ledger.close(entry, 0)
    assert ledger.examine(later[0], Arm(), 50_000, 6000) is Admission.FULL
    assert ledger.examine(later[0], Arm(), 90_000, 50_001) is Admission.NEW


def test_an_id_from_a_journal_matches_any_contents(ledger: Ledger[None]) -> None:
    ledger.close(ledger.enter(ONE, None, None, 0), 0)
    assert ledger.examine(ONE, Disarm(), 5000, 10) is Admission.DUPLICATE


def fill_by(ledger: Ledger[None], share: Share, station: int) -> int:
    """Enter ids of one station in a share until there is no room for it; how many."""
    for seq in range(FOG_CAPACITY):
        command_id = CommandId(1000 * station + share.value, seq)
        if ledger.examine(command_id, Arm(), 100, 0, share, station) is not Admission.NEW:
            return seq
        ledger.close(ledger.enter(command_id, Arm(), None, 100, share, station), 0)
    raise AssertionError("never full")


def fill(ledger: Ledger[None], share: Share) -> int:
    """As many stations as it takes until there is no room for another one."""
    taken = 0
    for station in range(1, 100):
        more = fill_by(ledger, share, station)
        taken += more
        if more == 0:
            return taken
    raise AssertionError("never full")


def test_outsiders_fill_their_share_and_what_halts_a_drone_finds_room_last(ledger: Ledger[None]) -> None:
    assert fill(ledger, Share.OUTSIDERS) == CAPACITY // 4
    assert fill(ledger, Share.ORDINARY) == CAPACITY - CAPACITY // 4 - CAPACITY // 16
    assert fill(ledger, Share.OVERRIDING) == CAPACITY // 16
    assert len(ledger.entries()) == CAPACITY


@pytest.mark.parametrize("share", Share)
def test_one_station_leaves_as_much_of_a_share_as_it_takes(share: Share, ledger: Ledger[None]) -> None:
    first, second, third = (fill_by(ledger, share, station) for station in (1, 2, 3))
    assert first > 2 * third > 0
    assert abs(first - 2 * second) <= 1
    assert ledger.examine(ONE, Arm(), 5000, 0, share, 4) is Admission.NEW


def test_one_station_may_command_a_fog_37_times_per_second_for_good() -> None:
    taken = fill_by(Ledger(FOG_CAPACITY), Share.ORDINARY, 1)
    assert taken == 22_528
    assert taken > 37 * KEEP_MS / 1000


def test_one_station_that_fills_all_it_can_leaves_the_others_room_for_everything(ledger: Ledger[None]) -> None:
    for share in Share:
        fill_by(ledger, share, 1)
    for share in Share:
        assert fill_by(ledger, share, 2) > 500


def test_who_is_denied_for_want_of_room_bars_itself_alone(ledger: Ledger[None]) -> None:
    fill_by(ledger, Share.ORDINARY, 1)
    assert ledger.examine(ONE, Arm(), 60_000, 0, Share.ORDINARY, 1) is Admission.FULL
    assert ledger.examine(TWO, Arm(), 5000, 0, Share.ORDINARY, 2) is Admission.NEW


def test_outsiders_without_room_hear_nothing_and_bar_nobody(ledger: Ledger[None]) -> None:
    """What is denied must not be executed later; what was not answered may be, by a station that took control."""
    fill(ledger, Share.OUTSIDERS)
    assert ledger.examine(ONE, Arm(), 5000, 0, Share.OUTSIDERS) is Admission.IGNORED
    assert ledger.examine(ONE, Arm(), 5000, 0, Share.ORDINARY) is Admission.NEW


def test_an_ordinary_command_that_is_denied_bars_no_landing(ledger: Ledger[None]) -> None:
    fill(ledger, Share.ORDINARY)
    assert ledger.examine(ONE, Arm(), 5000, 0, Share.ORDINARY) is Admission.FULL
    assert ledger.examine(TWO, Land(), 5000, 0, Share.of(Land(), in_control=True)) is Admission.NEW


def test_room_comes_back_with_time(ledger: Ledger[None]) -> None:
    fill(ledger, Share.OUTSIDERS)
    assert ledger.examine(ONE, Arm(), 5000, KEEP_MS + 101, Share.OUTSIDERS) is Admission.NEW
    assert ledger.entries() == []


def test_what_several_executors_may_get_takes_a_place_for_each_and_gives_them_back() -> None:
    ledger: Ledger[None] = Ledger(capacity=1024, keep_ms=10)
    alone = fill_by(Ledger(capacity=1024), Share.ORDINARY, 1)
    taken, seq = 0, 0
    while ledger.examine(CommandId(7, seq), Arm(), 100, 0, Share.ORDINARY, 1, places=25) is Admission.NEW:
        ledger.close(ledger.enter(CommandId(7, seq), Arm(), None, 100, Share.ORDINARY, 1, places=25), 0)
        taken, seq = taken + 25, seq + 1
    assert alone - 25 < taken <= alone
    assert fill_by(ledger, Share.ORDINARY, 2) > alone // 2 - 25, "another station has its half of the rest"
    assert ledger.examine(CommandId(8, 0), Arm(), 900, 800, Share.ORDINARY, 1, places=25) is Admission.NEW
    assert fill_by(ledger, Share.ORDINARY, 1) == alone
