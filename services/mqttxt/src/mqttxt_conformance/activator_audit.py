"""Rules of an activator about its audit log (section 14), a file that the kit reads."""

from __future__ import annotations

from mqttxt.protocol.commands import Arm

from .activator_kit import ActivatorKit
from .audit_lines import judged
from .registry import rule


@rule("activator", "R14.1", "R14.2", "R14.3")
async def keeps_an_audit_log(kit: ActivatorKit) -> str:
    """Its audit log has each command once, its station and its last word, and each line the hash of the one before."""
    message = kit.send(Arm())
    await kit.outcome(message)
    kit.publish(message)
    return await judged(kit.audit, kit.session, message, 1, f"gs-{kit.station.name}", signed=False)
