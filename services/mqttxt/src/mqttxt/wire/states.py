"""A state's payload: its stamps in front, its fields behind; the topic names the state.

On the fog side `[stamp, fields…]`, on the cloud side `[relay_stamp, stamp, fields…]`.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, make_dataclass
from functools import cache
from typing import Any, get_type_hints

from ..errors import PayloadError
from ..states import STATES, State
from .codec import decode, encode
from .fields import Stamp
from .values import Encoding


@dataclass(frozen=True)
class StampedState:
    """A state with its origin's stamp and, behind an activator, the activator's own."""

    state: State
    stamp: int
    relay_stamp: int | None = None


@cache
def message_class(name: str, relayed: bool) -> type[Any]:
    """The message of state `name`, as `codec` and `schema` take it; raises PayloadError for an unknown name."""
    if name not in STATES:
        raise PayloadError(f"state {name!r}: expected one of {', '.join(STATES)}", "state")
    stamps = [("relay_stamp", Stamp)] if relayed else []
    hints = get_type_hints(STATES[name], include_extras=True)
    own = [(field.name, hints[field.name]) for field in fields(STATES[name])]
    title = "".join(part.title() for part in name.split("_")) + ("Relayed" if relayed else "")
    return make_dataclass(title, [*stamps, ("stamp", Stamp), *own], frozen=True)


def encode_state(message: StampedState, encoding: Encoding) -> bytes:
    """The payload of a state."""
    cls = message_class(message.state.name, message.relay_stamp is not None)
    stamps = {"stamp": message.stamp}
    if message.relay_stamp is not None:
        stamps["relay_stamp"] = message.relay_stamp
    return encode(cls(**stamps, **vars(message.state)), encoding)


def decode_state(name: str, payload: bytes, relayed: bool) -> StampedState:
    """The state `name` in a payload; raises PayloadError."""
    values = dict(vars(decode(message_class(name, relayed), payload)))
    relay_stamp = values.pop("relay_stamp", None)
    return StampedState(stamp=values.pop("stamp"), relay_stamp=relay_stamp, state=STATES[name](**values))
