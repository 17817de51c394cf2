"""A small load of whole roles: every command to eighty drones is carried out once, in time, and has its last word."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.bench.load import Fogs, run

pytestmark = [pytest.mark.integration, pytest.mark.alone]


async def test_no_command_is_lost_late_or_doubled_while_eighty_drones_publish(tmp_path: Path) -> None:
    found = await run(tmp_path, Fogs(2, 40), lasting_s=6.0, every_s=2.0)
    assert (found.lost, found.late, found.doubled) == (0, 0, 0)
    assert found.words["completed"] == found.commands >= 160
