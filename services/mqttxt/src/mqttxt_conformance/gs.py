"""Checks a ground station: the kit plays its fog's activator and drone."""

from __future__ import annotations

import secrets
from collections.abc import Callable

from mqttxt.core.address import BrokerAddress
from mqttxt.core.clock import SessionClock

from . import gs_rules
from .gs_kit import GsKit, GsTarget
from .registry import RULES, Broken, Finding, Rule, check_all, unmet
from .subject import Subject
from .tap import Tap


def rules() -> list[Rule]:
    """Every rule of a ground station in the order in which it is checked."""
    return RULES["gs"]


async def check_gs(broker: BrokerAddress, target: GsTarget, on_finding: Callable[[Finding], None]) -> list[Finding]:
    """Check a ground station; raises ConfigurationError for what cannot be tested as it was asked."""
    clock = SessionClock()
    values = {"broker": str(broker), "fog": str(target.fog), "drone": str(target.drone)}
    subject = Subject(target.run, values, target.log)
    tap = Tap(broker, f"conformance-{secrets.token_hex(4)}", clock)
    await tap.connect("--broker")
    kit = GsKit(target.fog, target.drone, target.prefix, tap, subject, clock, target.ttl_s)
    try:
        tap.on_heard = kit.on_heard
        topics = kit.topics
        commands = (topics.broadcast, f"{topics.root}+/commands")
        await tap.subscribe(f"{target.prefix}gs/+/reachable", topics.init_connect, *commands)
        try:
            await kit.play()
        except Broken as broken:
            return unmet(rules(), "registers-as-specified", str(broken), on_finding)
        return await check_all(rules(), kit, on_finding)
    finally:
        await kit.close()


__all__ = ["GsTarget", "check_gs", "gs_rules", "rules"]
