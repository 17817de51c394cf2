"""A state's payload: its stamps in front, its fields behind; the topic names the state.

On the fog side `[stamp, fields…]`, on the cloud side `[relay_stamp, stamp, fields…]`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, fields, make_dataclass
from functools import cache
from typing import Any, get_type_hints

import cbor2

from ..errors import PayloadError
from .codec import decode_values, encode
from .fields import Stamp
from .mavlink_states import fields_of, kind_of
from .states import STATES, MavlinkState, State
from .topics import MAVLINK_STATE
from .values import Encoding

_SHORT_ARRAYS = range(0x80, 0x97)
"""First bytes of CBOR arrays of at most 22 items: one more fits into the same byte (RFC 8949, 3)."""


@dataclass(frozen=True)
class StampedState:
    """A state with its origin's stamp and, behind an activator, the activator's own.

    `origin` is the CBOR that it was decoded from on the fog side, of which a relay can make its own.
    """

    state: State
    stamp: int
    relay_stamp: int | None = None
    origin: bytes | None = field(default=None, compare=False, repr=False)


@cache
def message_class(name: str, relayed: bool) -> type[Any]:
    """The message of state `name`, as `codec` and `spec.schema` take it; raises PayloadError for an unknown name."""
    stamps = [("relay_stamp", Stamp)] if relayed else []
    own = STATES[name].__name__ if name in STATES else "".join(part.title() for part in re.split("[_/]", name))
    title = own + ("Relayed" if relayed else "")
    return make_dataclass(title, [*stamps, ("stamp", Stamp), *_fields_of(name)], frozen=True)


def _fields_of(name: str) -> list[Any]:
    if name in STATES:
        hints = get_type_hints(STATES[name], include_extras=True)
        return [(item.name, hints[item.name], field(default=item.default)) for item in fields(STATES[name])]
    if kind_of(name) is not None:
        return [*fields_of(name)]
    raise PayloadError(f"state {name!r}: expected {MAVLINK_STATE}NAME or one of {', '.join(STATES)}", "state")


def encode_state(message: StampedState, encoding: Encoding) -> bytes:
    """The payload of a state."""
    if message.origin is not None and message.relay_stamp is not None and encoding is Encoding.CBOR:
        return _relayed(message.origin, message.relay_stamp)
    cls = message_class(message.state.name, message.relay_stamp is not None)
    stamps = {"stamp": message.stamp}
    if message.relay_stamp is not None:
        stamps["relay_stamp"] = message.relay_stamp
    own = message.state.values if isinstance(message.state, MavlinkState) else vars(message.state)
    return encode(cls(**stamps, **own), encoding)


def decode_state(name: str, payload: bytes, relayed: bool) -> StampedState:
    """The state `name` in a payload; raises PayloadError."""
    values = decode_values(message_class(name, relayed), payload)
    relay_stamp, own_stamp = values.pop("relay_stamp", None), values.pop("stamp")
    origin = payload if not relayed and payload[0] in _SHORT_ARRAYS else None
    state = STATES[name](**values) if name in STATES else MavlinkState(name, values)
    return StampedState(state, own_stamp, relay_stamp, origin)


def _relayed(origin: bytes, relay_stamp: int) -> bytes:
    """A fog-side array with one more item in front; its head is one byte, and stays one."""
    return bytes((origin[0] + 1,)) + cbor2.dumps(relay_stamp) + origin[1:]
