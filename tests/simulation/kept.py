"""What a UAV client's journal would have kept."""

from __future__ import annotations

from dataclasses import replace

from mqttxt.drone.answers import Unfinished
from mqttxt.drone.effects import Journal
from mqttxt.protocol.messages import CommandId


class Kept:
    """A journal's contents, by the rules of `drone.journal`, without a disk."""

    def __init__(self) -> None:
        self.unfinished: dict[CommandId, Unfinished] = {}
        self.is_full = False

    def takes(self, effect: Journal) -> bool:
        """Record an effect unless the disk is full, which loses no more than that record."""
        if self.is_full:
            return False
        if not effect.done:
            self.unfinished[effect.id] = Unfinished(effect.id, effect.command, effect.word, effect.reason)
        elif effect.id in self.unfinished:
            self.unfinished[effect.id] = replace(self.unfinished[effect.id], delivered=True)
        return True
