"""Which commands a later hold, land or return has overridden, and how many of these are remembered (R7.6, R10.1)."""

from __future__ import annotations

import pytest

from mqttxt.core.ledger import FOG_CAPACITY
from mqttxt.core.overriding import LaterHolds

SENDER = 1


@pytest.fixture
def holds() -> LaterHolds:
    return LaterHolds()


@pytest.mark.parametrize(("held", "overridden"), [(1, {1}), (None, {1, 2, None})])
def test_a_hold_overrides_older_commands_to_its_drones_and_every_older_choice(
    holds: LaterHolds, held: int | None, overridden: set[int | None]
) -> None:
    holds.note(SENDER, held, 5)
    assert {target for target in (1, 2, None) if holds.overrides(SENDER, target, 4)} == overridden
    assert holds.overrides_choice(SENDER, 4)
    for sender, seq in ((SENDER, 5), (SENDER, 6), (SENDER + 1, 4)):
        assert not holds.overrides(sender, 1, seq)
        assert not holds.overrides_choice(sender, seq)


def test_an_older_hold_that_comes_late_takes_nothing_back(holds: LaterHolds) -> None:
    holds.note(SENDER, 1, 5)
    holds.note(SENDER, 1, 2)
    assert holds.overrides(SENDER, 1, 4)
    assert holds.overrides_choice(SENDER, 4)


def test_senders_without_number_displace_only_the_oldest(holds: LaterHolds) -> None:
    holds.note(SENDER, 1, 5)
    for sender in range(SENDER + 1, SENDER + FOG_CAPACITY):
        holds.note(sender, 1, 5)
    assert not holds.overrides_choice(SENDER, 4)
    assert holds.overrides_choice(sender, 4)
    assert len(holds._highest) == FOG_CAPACITY
