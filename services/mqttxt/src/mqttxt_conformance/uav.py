"""Checks a UAV client: the kit plays its activator and its autopilot."""

from __future__ import annotations

import secrets
from collections.abc import Callable

from mqttxt.core.address import BrokerAddress
from mqttxt.core.clock import SessionClock
from mqttxt.protocol.topics import FogSide

from . import uav_presence as presence
from .autopilot import Autopilot
from .registry import RULES, Broken, Finding, Rule, check_all, unmet
from .subject import Subject
from .tap import Tap, clear_retained
from .uav_kit import UavKit, UavTarget

# Their import enters their rules, in this order.
from . import uav_commands, uav_refusals, uav_control, uav_states  # isort: skip


ENDING = (
    presence.will_carries_the_session,
    presence.closes_what_a_crash_left_open,
    presence.a_clean_stop_says_down,
    presence.stops_when_refused,
    presence.does_not_start_at_another_system,
)
"""Rules that end the implementation; they come last."""
WATCHED = uav_states.__name__
"""Rules that are judged by everything that was heard before."""


def rules() -> list[Rule]:
    """Every rule of a UAV client in the order in which it is checked."""
    found = RULES["uav"]
    ending = [rule for rule in found if rule.check in ENDING]
    watched = [rule for rule in found if rule.check.__module__ == WATCHED]
    return [rule for rule in found if rule not in ending and rule not in watched] + watched + ending


async def check_uav(broker: BrokerAddress, target: UavTarget, on_finding: Callable[[Finding], None]) -> list[Finding]:
    """Check a UAV client; raises ConfigurationError for what cannot be tested as it was asked."""
    topics = FogSide(target.fog_root)
    clock = SessionClock()
    tap = Tap(broker, f"conformance-{secrets.token_hex(4)}", clock)
    host, port = target.autopilot_host, target.autopilot_port
    values = {"broker": str(broker), "drone": str(target.drone), "autopilot": f"udp:{host}:{port}"}
    subject = Subject(target.run, values, target.log)
    kit = UavKit(target.drone, topics, Autopilot(host, port, target.drone, clock), tap, subject, clock)
    await tap.connect("--broker")
    try:
        await clear_retained(tap, [topics.reachable(target.drone)] if subject.is_ours else [])
        tap.on_heard = kit.on_heard
        await tap.subscribe(f"{topics.root}drone{target.drone}/#")
        await kit.autopilot.start()
        if subject.is_ours:
            await subject.start()
        try:
            await kit.meet()
        except Broken as broken:
            return unmet(rules(), "birth-carries-the-session", str(broken), on_finding)
        return await check_all(rules(), kit, on_finding)
    finally:
        await kit.close()


__all__ = ["UavTarget", "check_uav", "rules", "uav_commands", "uav_control", "uav_refusals"]
