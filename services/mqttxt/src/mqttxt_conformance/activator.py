"""Checks an activator: the kit plays its ground stations and its UAV clients, on both brokers."""

from __future__ import annotations

import secrets
import tempfile
from collections.abc import Callable
from pathlib import Path

from mqttxt.core.address import BrokerAddress
from mqttxt.core.clock import SessionClock
from mqttxt.protocol.topics import CloudSide, FogSide

from . import activator_signed
from .activator_kit import PATIENCE_S, ActivatorKit, ActivatorTarget
from .activator_signed_kit import SignedActivatorKit
from .registry import RULES, Broken, Finding, Rule, check_all, check_met, unmet
from .sealed import STATION, Folder
from .subject import Subject
from .tap import Tap, clear_retained

# Importing these modules registers their rules, in this order.
from . import activator_gate, activator_presence, activator_commands, activator_audit  # isort: skip
from . import activator_control, activator_floods, activator_two_brokers  # isort: skip

ENDING = (
    activator_presence.leaves_a_connection_that_delivers_nothing,
    activator_presence.will_carries_the_session,
    activator_presence.a_second_one_refuses_to_start,
    activator_presence.a_clean_stop_says_down,
)
"""Rules that end the implementation; they are checked last."""


def rules() -> list[Rule]:
    """Every rule of an activator in the order in which it is checked."""
    found = RULES["activator"]
    return [rule for rule in found if rule.check not in ENDING] + [rule for rule in found if rule.check in ENDING]


async def check_activator(
    cloud_broker: BrokerAddress,
    fog_broker: BrokerAddress,
    target: ActivatorTarget,
    on_finding: Callable[[Finding], None],
) -> list[Finding]:
    """Check an activator; raises ConfigurationError for an unreachable broker, a bad `run` or a missing identity."""
    if target.folder is not None:
        return await _check_signed(cloud_broker, fog_broker, target, target.folder, on_finding)
    with tempfile.TemporaryDirectory(prefix="mqttxt-conformance-") as own:
        return await _check(cloud_broker, fog_broker, target, on_finding, Path(own))


async def _check(
    cloud_broker: BrokerAddress,
    fog_broker: BrokerAddress,
    target: ActivatorTarget,
    on_finding: Callable[[Finding], None],
    files: Path,
) -> list[Finding]:
    """Check an activator that does not sign; `files` is a folder for the files that the kit names in `run`."""
    topics, fog_side = CloudSide(target.fog, target.prefix), FogSide(target.fog_root)
    clock = SessionClock()
    values = {
        "broker": str(cloud_broker),
        "fog_broker": str(fog_broker),
        "fog": str(target.fog),
        "drones": "1,2",
        "fog_root": target.fog_root,
        "audit": str(files / "audit.log"),
    }
    values |= {"second_fog_broker": str(target.second)} if target.second is not None else {}
    subject = Subject(target.run, values, target.log)
    own = f"conformance-{secrets.token_hex(4)}"
    cloud, fog = Tap(cloud_broker, own, clock), Tap(fog_broker, f"{own}-fog", clock)
    await cloud.connect("--broker")
    await fog.connect("--fog-broker")
    second, checked = None, rules()
    if target.second is not None:
        second, checked = Tap(target.second, f"{own}-second", clock), RULES[activator_two_brokers.ROLE]
        await second.connect("--second-fog-broker")
    kit = ActivatorKit(topics, fog_side, cloud, fog, subject, clock, second)
    kit.audit = files / "audit.log" if subject.names("audit") else None
    try:
        for each in kit.fogs:
            await clear_retained(each, [fog_side.reachable(number) for number in (1, 2)])
        if subject.is_ours:
            records = [topics.drone_reachable(number) for number in (1, 2)]
            await clear_retained(cloud, [topics.reachable, *records])
        cloud.on_heard = kit.on_cloud
        await cloud.subscribe(f"{topics.root}#")
        for each in kit.fogs:
            each.on_heard = kit.on_fog
            await each.subscribe(*(f"{fog_side.root}drone{number}/#" for number in (1, 2)))
        if subject.is_ours:
            await subject.start()
        try:
            await kit.meet()
        except Broken as broken:
            return unmet(checked, checked[0].name, str(broken), on_finding)
        await kit.add_drones()
        if second is not None:
            kit.station.register()
            await cloud.until(lambda: kit.record(1).get("holder") == kit.station.name, PATIENCE_S)
        return await check_all(checked, kit, on_finding)
    finally:
        await kit.close()


async def _check_signed(
    cloud_broker: BrokerAddress,
    fog_broker: BrokerAddress,
    target: ActivatorTarget,
    folder: Folder,
    on_finding: Callable[[Finding], None],
) -> list[Finding]:
    """Check the rules of section 12; each part of the kit has a connection with its own identity."""
    topics, fog_side, clock = CloudSide(target.fog, target.prefix), FogSide(target.fog_root), SessionClock()
    values = {"broker": str(cloud_broker), "fog_broker": str(fog_broker), "fog": str(target.fog), "drones": "1,2"}
    values |= {"fog_root": target.fog_root, "identity": str(folder.path / f"fog{target.fog}")}
    subject = Subject(target.run, values, target.log)

    def tap(broker: BrokerAddress, name: str) -> Tap:
        return Tap(broker, f"conformance-{secrets.token_hex(4)}", clock, folder.identity(name))

    cloud, fog = tap(cloud_broker, f"gs-{STATION}"), {number: tap(fog_broker, f"drone{number}") for number in (1, 2)}
    kit = SignedActivatorKit(folder, topics, fog_side, cloud, fog, subject, clock)
    await cloud.connect("--broker")
    for each in fog.values():
        await each.connect("--fog-broker")
    try:
        if subject.is_ours:
            before = tap(cloud_broker, kit.name)
            await before.connect("--broker")
            left = [topics.reachable, *map(topics.drone_reachable, fog), *map(topics.drone_birth, fog)]
            await clear_retained(before, left)
            await before.close()
        await cloud.subscribe(f"{topics.root}#")
        for number, each in fog.items():
            await each.subscribe(f"{fog_side.root}drone{number}/#")
        if subject.is_ours:
            await subject.start()
        first, checked = "birth-carries-its-certificate", activator_signed.rules()
        return await check_met(kit.meet(), first, checked, kit, on_finding)
    finally:
        await kit.close()


__all__ = [
    "ActivatorTarget",
    "activator_audit",
    "activator_commands",
    "activator_control",
    "activator_floods",
    "activator_gate",
    "activator_signed",
    "check_activator",
    "rules",
]
