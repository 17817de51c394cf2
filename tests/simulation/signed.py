"""Helpers for tests of the signed mode: a fog that signs, and its messages."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from mqttxt.core.effects import Log, Publish
from mqttxt.protocol.codec import encode
from mqttxt.protocol.commands import Arm, Command
from mqttxt.protocol.messages import Presence, ResultMessage, Word
from mqttxt.protocol.rankings import SelectMessage, SelectMode
from mqttxt.security.cose import Envelope
from mqttxt.security.seal import Seal
from mqttxt.station.outcomes import Outcome
from tests.simulation.signing import seal
from tests.simulation.world import FOG_SESSION, GS_SESSION, UAV_SESSION, World, command_payload, results

OTHER_SESSION = 0x77


def signed_world() -> World:
    """A fog that signs, its drone under the control of station g."""
    made = World(signed=True).start(1000)
    made.logs.clear()
    made.heard.clear()
    return made


def signed_command(by: Seal | None = None, topic: str = "drone1/commands", **changed: Any) -> Envelope:
    """Arm as station g signs it, in the drone's session, unless a test changes that."""
    fields = {"seq": 9, "deadline_ms": 5000, **changed}
    return (by or seal("gs-g")).sign(topic, encode(command_payload(fields.pop("command", Arm()), **fields)))


def chosen(world: World, mode: SelectMode, command: Command) -> SelectMessage:
    """What station g asks its fog for the best drone, as the command 50."""
    ids = {"gs_session": GS_SESSION, "seq": 50, "executor_session": FOG_SESSION}
    return SelectMessage(**ids, deadline_ms=world.now_ms + 5000, limit_s=60.0, epoch=0, mode=mode, command=command)


def to_drone(
    world: World, envelope: Envelope | bytes, topic: str = "drone1/commands", retain: bool = False
) -> list[Any]:
    payload = envelope if isinstance(envelope, bytes) else envelope.encode()
    return world.hears("uav", topic, payload, retain)


def said(effects: list[Any]) -> list[tuple[Word, str | None]]:
    opened = [
        replace(effect, payload=Envelope.parse(effect.payload).payload)
        for effect in effects
        if isinstance(effect, Publish) and "/commands_result/" in effect.topic
    ]
    return [(result.word, result.reason) for result in results(opened)]


def kinds(effects: list[Any]) -> list[str]:
    return [effect.kind for effect in effects if isinstance(effect, Log)]


def outcomes(world: World) -> list[tuple[Word, str | None, str | None]]:
    return [(o.word, o.reason, o.signer) for o in world.heard if isinstance(o, Outcome)]


def last_sent(world: World, topic: str) -> Publish:
    return next(publish for _, publish in reversed(world.sent) if publish.topic == topic)


def meet(world: World, station: Seal, session: int) -> None:
    """Introduce another station to the drone: its birth arrives as the activator passes it on."""
    topic = f"gs/{station.certificate.node.label}/reachable"
    birth = station.sign(topic, encode(Presence(session=session, up=True)), with_certificate=True)
    out = world.hears("uav", "drone1/stations", birth.encode())
    world.logs += [effect for effect in out if isinstance(effect, Log)]


def word(by: str, said_word: Word, topic: str, session: int = UAV_SESSION, seq: int = 1) -> bytes:
    result = ResultMessage(gs_session=GS_SESSION, seq=seq, session=session, stamp=1, word=said_word)
    return seal(by).sign(topic, encode(result)).routed([1, False]).encode()


def hear(world: World, payload: bytes) -> list[Any]:
    out = world.hears("gs", "fog1/drone1/commands_result/arm", payload)
    world.heard += [effect for effect in out if isinstance(effect, Outcome)]
    return out
