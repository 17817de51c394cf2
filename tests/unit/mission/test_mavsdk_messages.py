"""A call over MAVLink that was repeated: no copy of it may be taken for the next one."""

from __future__ import annotations

import asyncio

import pytest

from mission import mavsdk_messages
from mission.mavsdk_messages import _and_its_copies


@pytest.mark.parametrize(("repeated_s", "waits"), [(0.0, 1), (60.0, 0)])
async def test_copies_of_a_call_are_waited_for_where_it_was_repeated(
    repeated_s: float, waits: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    slept: list[float] = []

    async def sleep(seconds: float) -> None:
        slept.append(seconds)

    monkeypatch.setattr(mavsdk_messages, "REPEATED_S", repeated_s)
    async with _and_its_copies():
        await asyncio.sleep(0)
        monkeypatch.setattr(asyncio, "sleep", sleep)
    assert len(slept) == waits
