"""A call over MAVLink that was repeated: no copy of it may be taken for the next one."""

from __future__ import annotations

import asyncio
import contextlib
from io import StringIO
from pathlib import Path

import pytest

from mission.events import EventLog
from mission.fleet import MissionError
from mission.mavsdk_messages import MavsdkMessageFleet


@pytest.mark.parametrize("fails", [False, True])
@pytest.mark.parametrize(("took_s", "waited_s"), [(0.4, []), (1.2, [pytest.approx(1.2)])])
async def test_copies_of_a_call_are_waited_for_where_it_was_repeated(
    took_s: float, waited_s: list[float], fails: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = EventLog(Path("/dev/null"), StringIO())
    fleet = MavsdkMessageFleet(("udpin://127.0.0.1:0",), {1: (1,)}, "one-by-one", "px4-onboard", log)
    now_s, waited = [100.0], []

    async def wait(seconds: float) -> None:
        waited.append(seconds)

    monkeypatch.setattr(asyncio, "sleep", wait)
    monkeypatch.setattr(asyncio.get_running_loop(), "time", lambda: now_s[0])
    with contextlib.suppress(MissionError), fleet._noting_copies():
        now_s[0] += took_s
        if fails:
            raise MissionError("no answer")
    settled = await fleet.settle()
    monkeypatch.undo()
    assert settled
    assert waited == waited_s
