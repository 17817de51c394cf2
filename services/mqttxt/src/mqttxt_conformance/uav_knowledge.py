"""Rules of a UAV client about the states that it knows, and to whom it says them again (R3.5)."""

from __future__ import annotations

import asyncio

from .registry import expect, rule
from .uav_kit import QUIET_S, UavKit

_ANEW = {"armed", "flight_mode", "landed_state", "home", "battery"}
"""States that an activator who has just subscribed has to get."""
_SAID_S = 4.0
_KNOWN_S = 10.0
_WITHHELD, UNKNOWN = "VFR_HUD", "groundspeed"
"""A message of MAVLink, and the state that it alone carries."""


def _said(kit: UavKit, mark: int) -> set[str]:
    return {heard.topic.rsplit("/", 1)[1] for heard, _ in kit.states[mark:]}


@rule("uav", "R3.5")
async def says_states_again_to_who_lacks_them(kit: UavKit) -> str:
    """After a lease with `anew` each known state is published once more, changed or not."""
    await kit.calm()
    await asyncio.sleep(2.0)
    mark = len(kit.states)
    await kit.echo(anew=True)
    await kit.tap.until(lambda: _said(kit, mark) >= _ANEW, _SAID_S)
    missing = sorted(_ANEW - _said(kit, mark))
    expect(not missing, f"after a lease with `anew` not published again: {', '.join(missing)}")
    return f"after a lease with `anew`: {', '.join(sorted(_said(kit, mark)))}"


@rule("uav", "R3.5")
async def says_nothing_that_it_does_not_know(kit: UavKit) -> str:
    """A state whose message has not come for 10 s is not published, after a lease with `anew` neither."""
    await kit.calm()
    kit.autopilot.withheld = frozenset({_WITHHELD})
    await asyncio.sleep(_KNOWN_S + 1)
    mark = len(kit.states)
    await kit.echo(anew=True)
    await kit.tap.until(lambda: _said(kit, mark) >= _ANEW, _SAID_S)
    await asyncio.sleep(QUIET_S)
    said = _said(kit, mark)
    await kit.calm()
    expect(said >= _ANEW, f"after a lease with `anew` not published again: {', '.join(sorted(_ANEW - said))}")
    expect(UNKNOWN not in said, f"{UNKNOWN} was published, whose {_WITHHELD} has not come for {_KNOWN_S + 1:g} s")
    return f"without {_WITHHELD} for {_KNOWN_S + 1:g} s: {', '.join(sorted(said))}, not {UNKNOWN}"
