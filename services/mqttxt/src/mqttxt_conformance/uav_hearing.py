"""Rules of a UAV client about a connection that delivers nothing (R9.17)."""

from __future__ import annotations

from functools import partial
from typing import Any

from . import shapes
from .deaf import SILENT_S, leaves
from .registry import NotTested, expect, rule
from .uav_kit import UavKit

_GRACE_S = 3.0


def _births(kit: UavKit, mark: int) -> list[dict[str, Any]]:
    said = [heard.payload for heard in kit.tap.since(mark, kit.topics.reachable(kit.drone)) if heard.payload]
    return [found for found in (shapes.read("presence", payload) for payload in said) if found["up"]]


@rule("uav", "R9.17")
async def asks_whether_it_is_heard(kit: UavKit) -> str:
    """Where it has heard nothing for 12 s it publishes its birth again."""
    await kit.calm()
    await kit.echo()
    mark, began_ms = len(kit.tap.heard), kit.clock.now_ms()
    found = await kit.tap.until(partial(_births, kit, mark), SILENT_S + _GRACE_S)
    after_s = (kit.clock.now_ms() - began_ms) / 1000
    expect(found, f"no birth in {after_s:.1f} s in which it heard nothing")
    expect(after_s > SILENT_S - 2, f"its birth came again after {after_s:.1f} s of silence")
    expect(found[-1]["session"] == kit.session, f"birth {found[-1]}, expected session {kit.session}")
    return f"its birth came again after {after_s:.1f} s of silence"


@rule("uav", "R9.17")
async def leaves_a_connection_that_delivers_nothing(kit: UavKit) -> str:
    """Where its own birth does not come back within 5 s, it ends the connection with 0x04, and connects anew."""
    kit.subject.need()
    if kit.broker is None or kit.broker.tls:
        raise NotTested("needs a broker without TLS: the kit withholds what the broker delivers")
    return await leaves(kit, kit.broker, kit.tap)
