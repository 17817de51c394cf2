"""An executor and its autopilot on a bench: messages and time in, words and writes out."""

from __future__ import annotations

from typing import Any

from mqttxt.drone.acknowledgements import WORDS_MS
from mqttxt.drone.effects import Transmit
from mqttxt.drone.executor import Executor
from mqttxt.drone.mavlink.vehicle import Vehicle
from mqttxt.drone.runs import Said
from mqttxt.protocol.commands import Command
from mqttxt.protocol.messages import CommandId, Word
from tests.simulation.world import heartbeat, home, landed, position

ARM, TAKEOFF, LAND, MODE, REPOSITION = 400, 22, 21, 176, 192


class Bench:
    """An executor and its vehicle, whose autopilot has reported everything."""

    def __init__(self, *told: Any) -> None:
        self.vehicle = Vehicle(1)
        self.executor = Executor(self.vehicle)
        self.now_ms = 0
        for message in told or (heartbeat(armed=True), home(), position(), landed(1)):
            self.vehicle.update(message, 0)

    def start(self, seq: int, command: Command, deadline_ms: int = 60_000, limit_ms: int = 60_000) -> list[Any]:
        return self.executor.start(CommandId(1, seq), command, deadline_ms, limit_ms, self.now_ms)

    def hear(self, *messages: Any) -> list[Any]:
        out: list[Any] = []
        for message in messages:
            self.vehicle.update(message, self.now_ms)
            out += self.executor.on_message(message, self.now_ms)
        return out

    def until(self, now_ms: int, step_ms: int = 100) -> list[Any]:
        """Let time pass with the autopilot alive."""
        out: list[Any] = []
        while self.now_ms < now_ms:
            self.now_ms += step_ms
            self.vehicle.heartbeat_ms = self.vehicle.heard_ms = self.now_ms
            out += self.executor.tick(self.now_ms)
        return out

    def refuse(self, *messages: Any) -> list[Any]:
        """Hear a refusal, and pass the time in which its last word waits for a text."""
        return self.hear(*messages) + self.until(self.now_ms + WORDS_MS)


def said(outputs: list[Any]) -> list[tuple[int, Word, str | None]]:
    return [(o.id.seq, o.word, o.reason) for o in outputs if isinstance(o, Said)]


def written(outputs: list[Any]) -> list[int]:
    """The MAV_CMDs among the writes."""
    return [o.message.command for o in outputs if isinstance(o, Transmit) and hasattr(o.message, "command")]


def set_points(outputs: list[Any]) -> list[Any]:
    """The set-points among the writes."""
    kinds = ("SET_POSITION_TARGET_LOCAL_NED", "SET_ATTITUDE_TARGET")
    return [o for o in outputs if isinstance(o, Transmit) and o.message.get_type() in kinds]
