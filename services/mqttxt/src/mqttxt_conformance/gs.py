"""Checks a ground station: the kit plays its fog's activator and drone."""

from __future__ import annotations

import secrets
from collections.abc import Callable

from mqttxt.core.address import BrokerAddress
from mqttxt.core.clock import SessionClock
from mqttxt.protocol.topics import CloudSide

from . import gs_rules, gs_signed
from .gs_kit import GsKit, GsTarget
from .gs_script import play
from .registry import RULES, Finding, Rule, check_met
from .sealed import STATION
from .secured import SecuredFog
from .subject import Subject
from .tap import Tap


def rules(signed: bool = True) -> list[Rule]:
    """Every rule of a ground station in the order in which it is checked; section 12 where messages are signed."""
    return [rule for rule in RULES["gs"] if signed or rule.check.__module__ != gs_signed.__name__]


async def check_gs(broker: BrokerAddress, target: GsTarget, on_finding: Callable[[Finding], None]) -> list[Finding]:
    """Check a ground station; raises ConfigurationError for an unreachable broker, a bad `run`, a missing identity."""
    clock = SessionClock()
    values = {"broker": str(broker), "fog": str(target.fog), "drone": str(target.drone)}
    values |= {"identity": str(target.folder.path / f"gs-{STATION}")} if target.folder is not None else {}
    subject = Subject(target.run, values, target.log)
    folder, topics = target.folder, CloudSide(target.fog, target.prefix)
    activator = folder.identity(f"fog{target.fog}") if folder is not None else None
    tap = Tap(broker, f"conformance-{secrets.token_hex(4)}", clock, identity=activator)
    secured = SecuredFog(folder, topics, target.drone) if folder is not None and folder.signed else None
    if secured is not None:
        tap.seal, tap.read = secured.sealed, secured.read
    await tap.connect("--broker")
    kit = GsKit(target.fog, target.drone, target.prefix, tap, subject, clock, target.ttl_s, secured)
    if folder is not None:  # its retained topic is the station's own
        kit.twin = Tap(broker, f"conformance-{secrets.token_hex(4)}", clock, identity=folder.identity(f"gs-{STATION}"))
        await kit.twin.connect("--broker")
    try:
        tap.on_heard = kit.on_heard
        commands = [topics.broadcast, f"{topics.root}+/commands"]
        if secured is not None:
            commands += [topics.drone_control(target.drone), topics.drone_sensor_ack(target.drone)]
        await tap.subscribe(f"{target.prefix}gs/+/reachable", topics.init_connect, *commands)
        checked = rules(secured is not None)
        return await check_met(play(kit), "registers-as-specified", checked, kit, on_finding)
    finally:
        await kit.close()


__all__ = ["GsTarget", "check_gs", "gs_rules", "gs_signed", "rules"]
