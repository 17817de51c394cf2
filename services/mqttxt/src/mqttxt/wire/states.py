"""A state's payload: its stamps in front, its fields behind; the topic names the state.

On the fog side `[stamp, fields…]`, on the cloud side `[relay_stamp, stamp, fields…]`.
"""

from __future__ import annotations

from dataclasses import dataclass, make_dataclass
from functools import cache
from typing import Any

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
    stamps.append(("stamp", Stamp))
    own = [(field, hint) for field, hint in STATES[name].__annotations__.items() if "ClassVar" not in str(hint)]
    title = "".join(part.title() for part in name.split("_")) + ("Relayed" if relayed else "")
    module = STATES[name].__module__
    return make_dataclass(title, [*stamps, *own], frozen=True, namespace={"__module__": module})


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
