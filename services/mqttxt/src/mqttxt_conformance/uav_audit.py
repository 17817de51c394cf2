"""Rules of a UAV client about its audit log (section 14), a file that the kit reads."""

from __future__ import annotations

from mqttxt.protocol.commands import Arm

from .audit_lines import judged
from .registry import rule
from .sealed import STATION
from .uav_kit import UavKit


@rule("uav", "R14.1", "R14.2", "R14.3")
async def keeps_an_audit_log(kit: UavKit) -> str:
    """Its audit log has each command once and its last word, and each line the hash of the one before."""
    await kit.calm()
    message = kit.send(Arm())
    await kit.outcome(message)
    kit.publish(message)
    signed = kit.secured is not None
    who = f"gs-{STATION}" if signed else None
    return await judged(kit.audit, kit.session, message, kit.drone, who, signed)
