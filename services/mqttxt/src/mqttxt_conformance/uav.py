"""Checks a UAV client: the kit plays its activator and its autopilot."""

from __future__ import annotations

import secrets
import tempfile
from collections.abc import Callable
from pathlib import Path

from mqttxt.core.address import BrokerAddress
from mqttxt.core.clock import SessionClock
from mqttxt.protocol.topics import FogSide

from . import uav_presence as presence
from .autopilot import Autopilot
from .mavlink_signing import Signer
from .registry import RULES, Finding, Rule, check_met
from .relay import Relay, Two
from .secured import SecuredUav
from .subject import Subject
from .tap import Tap, clear_retained
from .uav_kit import UavKit, UavTarget

# Importing these modules registers their rules, in this order.
from . import uav_commands, uav_halting, uav_pilot, uav_refusals, uav_control, uav_offboard  # isort: skip
from . import uav_parameters, uav_logs, uav_audit, uav_mavlink_key, uav_signed  # isort: skip
from . import uav_knowledge, uav_hearing, uav_two_links, uav_states  # isort: skip


ENDING = (
    presence.will_carries_the_session,
    presence.closes_what_a_crash_left_open,
    uav_hearing.leaves_a_connection_that_delivers_nothing,
    uav_offboard.a_clean_stop_ends_offboard,
    presence.a_clean_stop_says_down,
    presence.stops_when_refused,
    presence.does_not_start_at_another_system,
)
"""Rules that end the implementation; they are checked last, in this order."""
LAST_WATCHED = (uav_signed.signs_what_it_says,)
WATCHED = uav_states.__name__
"""The module of rules that are judged by all earlier messages, as LAST_WATCHED are."""


def rules(signed: bool = True, keyed: bool | None = None) -> list[Rule]:
    """Every rule of a UAV client in the order in which it is checked; those of section 12 where messages are signed.

    `keyed` tells whether client and autopilot have a MAVLink key; None leaves the rules of section 13 in, all of them.
    """
    found = [rule for rule in RULES["uav"] if signed or rule.check.__module__ != uav_signed.__name__]
    if keyed is not None:
        left_out = uav_mavlink_key.WITHOUT_KEY if keyed else uav_mavlink_key.WITH_KEY
        found = [rule for rule in found if rule.check not in left_out]
    ending = [rule for check in ENDING for rule in found if rule.check is check]
    watched = [rule for rule in found if rule.check.__module__ == WATCHED]
    watched += [rule for rule in found if rule.check in LAST_WATCHED]
    return [rule for rule in found if rule not in ending and rule not in watched] + watched + ending


async def check_uav(broker: BrokerAddress, target: UavTarget, on_finding: Callable[[Finding], None]) -> list[Finding]:
    """Check a UAV client; raises ConfigurationError for an unreachable broker, a bad `run` or a missing identity."""
    with tempfile.TemporaryDirectory(prefix="mqttxt-conformance-") as own:
        return await _check(broker, target, on_finding, Path(own))


async def _check(
    broker: BrokerAddress, target: UavTarget, on_finding: Callable[[Finding], None], own: Path
) -> list[Finding]:
    """Check a UAV client; `own` is a folder for the files that the kit names in its command line."""
    topics = FogSide(target.fog_root)
    clock = SessionClock()
    folder, name = target.folder, f"drone{target.drone}"
    activator = folder.identity(f"fog{target.fog}") if folder is not None else None
    tap = Tap(broker, f"conformance-{secrets.token_hex(4)}", clock, identity=activator)
    host, port = target.autopilot_host, target.autopilot_port
    values = {"broker": str(broker), "drone": str(target.drone), "autopilot": f"udp:{host}:{port}"}
    relays = Relay(broker), Relay(target.second or broker)
    if target.second is not None:
        for option, relay in zip(("broker", "second_broker"), relays, strict=True):
            values[option] = str((await relay.start()).address)
    values |= {"fog": str(target.fog), "identity": str(folder.path / name)} if folder is not None else {}
    key, audit = own / "mavlink.key", own / "audit.log"
    values |= {"mavlink_key": str(key), "audit": str(audit)}
    subject = Subject(target.run, values, target.log)
    secured = SecuredUav(folder, target.fog, target.drone, topics) if folder is not None and folder.signed else None
    kit = UavKit(target.drone, topics, Autopilot(host, port, target.drone, clock), tap, subject, clock, secured)
    kit.broker, kit.audit = broker, audit if subject.names("audit") else None
    if subject.names("mavlink_key"):
        kit.autopilot.signer = Signer(secrets.token_bytes(32))
        key.touch(mode=0o600)
        key.write_text(f"{kit.autopilot.signer.key.hex()}\n", encoding="ascii")
    if secured is not None:
        tap.seal, tap.read = secured.sealed, secured.speech.read
    await tap.connect("--broker")
    if folder is not None:  # its retained topic is the drone's own
        kit.twin = Tap(broker, f"conformance-{secrets.token_hex(4)}", clock, identity=folder.identity(name))
        await kit.twin.connect("--broker")
    if target.second is not None:
        kit.also_at(await _two(target.second, target, kit, relays))
    keyed = kit.autopilot.signer is not None
    checked = rules(secured is not None, keyed) if target.second is None else RULES["uav with two connections"]
    try:
        await clear_retained(kit.twin, [topics.reachable(target.drone)] if subject.is_ours else [])
        tap.on_heard = kit.on_heard
        await tap.subscribe(f"{topics.root}drone{target.drone}/#")
        await kit.autopilot.start()
        if subject.is_ours:
            await subject.start()
        return await check_met(kit.meet(), checked[0].name, checked, kit, on_finding)
    finally:
        await kit.close()


async def _two(second: BrokerAddress, target: UavTarget, kit: UavKit, relays: tuple[Relay, Relay]) -> Two:
    """Connect the kit to the second broker in the same way as to the first."""
    folder, topics = target.folder, kit.topics
    activator = folder.identity(f"fog{target.fog}") if folder is not None else None
    tap = twin = Tap(second, f"conformance-{secrets.token_hex(4)}", kit.clock, identity=activator)
    tap.seal, tap.read = kit.tap.seal, kit.tap.read
    await tap.connect("--second-broker")
    if folder is not None:
        own = folder.identity(f"drone{target.drone}")
        twin = Tap(second, f"conformance-{secrets.token_hex(4)}", kit.clock, identity=own)
        await twin.connect("--second-broker")
    if kit.subject.is_ours:
        await clear_retained(twin, [topics.reachable(target.drone)])
    tap.on_heard = kit.on_heard
    await tap.subscribe(f"{topics.root}drone{target.drone}/#")
    return Two(tap, twin, relays)


__all__ = [
    "UavTarget",
    "check_uav",
    "rules",
    "uav_audit",
    "uav_commands",
    "uav_control",
    "uav_halting",
    "uav_hearing",
    "uav_knowledge",
    "uav_logs",
    "uav_mavlink_key",
    "uav_offboard",
    "uav_parameters",
    "uav_pilot",
    "uav_refusals",
    "uav_signed",
    "uav_two_links",
]
