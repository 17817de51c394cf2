"""Checks a broker, or a cluster of several nodes: whether it has the MQTT 5 features that the protocol needs."""

from __future__ import annotations

from collections.abc import Callable

from . import broker_delivery, broker_retained, broker_sessions
from .broker_kit import BrokerKit, BrokerTarget
from .registry import RULES, Finding, check_all

SIDES = ("cloud", "fog", "drone")
"""The places that a broker may be checked for; each needs other features."""


async def check_broker(target: BrokerTarget, on_finding: Callable[[Finding], None]) -> list[Finding]:
    """Check a broker; raises ConfigurationError if it does not answer or refuses the kit's publish or subscription."""
    kit = BrokerKit(target)
    try:
        await kit.begin()
        found = []
        for rule in RULES["broker"]:
            await kit.renew()
            found += await check_all([rule], kit, on_finding)
        return found
    finally:
        await kit.end()


__all__ = ["SIDES", "BrokerTarget", "broker_delivery", "broker_retained", "broker_sessions", "check_broker"]
