"""Whether a command that has begun may still be written to the autopilot (docs/protocol.md, R5.4, R5.15)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ..protocol.messages import CommandId


@dataclass
class WritePermit:
    """Asked before each write of a command, repetitions included.

    `has_control`: whether no other station has taken the place of the command's. `is_unsure`: whether no heartbeat has
    shown the mode since the process stood still (R5.15). `is_leaving`: the process ends, and begins nothing more.
    """

    has_control: Callable[[CommandId], bool] = lambda command_id: True
    is_unsure: Callable[[], bool] = lambda: False
    is_leaving: bool = False
