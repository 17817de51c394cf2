"""A state's payload: first its stamps, then its fields; the topic names the state.

On the fog side `[stamp, fields…]`, on the cloud side `[relay_stamp, stamp, fields…]`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, fields, make_dataclass
from functools import cache, lru_cache
from typing import Any, get_type_hints

from ..errors import PayloadError
from .cbor import encode_plain
from .codec import decode_values, encode, plain_of, values_of_array
from .fields import Stamp
from .mavlink_states import fields_of, kind_of
from .states import CODES, STATES, MavlinkState, State
from .topics import MAVLINK_STATE
from .values import Encoding, Plain

_SHORT_ARRAYS = range(0x80, 0x97)
"""First bytes of CBOR arrays of at most 22 items: the byte can count one more item (RFC 8949, section 3)."""


@dataclass(frozen=True)
class StampedState:
    """A state with its drone's stamp and, once an activator has relayed it, the activator's own."""

    state: State
    stamp: int
    relay_stamp: int | None = None


@dataclass(slots=True)
class PlainState:
    """A state that an activator relays: checked, but not decoded.

    `item` is its form in bundles: its code (None if it has none) and its fields in CBOR. `origin` is its payload, if it
    arrived singly and in CBOR to which a stamp is easily added.
    """

    name: str
    stamp: int
    item: list[Plain]
    origin: bytes | None = None

    @property
    def state(self) -> State:
        """The decoded state."""
        values = values_of_array(message_class(self.name, False), [self.stamp, *self.item[1:]])
        del values["stamp"]
        return _state_of(self.name, values)


@cache
def message_class(name: str, relayed: bool) -> type[Any]:
    """The message class of state `name`, for `codec` and `spec.schema`. Raises PayloadError for an unknown name."""
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
    cls = message_class(message.state.name, message.relay_stamp is not None)
    stamps = {"stamp": message.stamp}
    if message.relay_stamp is not None:
        stamps["relay_stamp"] = message.relay_stamp
    own = message.state.values if isinstance(message.state, MavlinkState) else vars(message.state)
    return encode(cls(**stamps, **own), encoding)


def decode_state(name: str, payload: bytes, relayed: bool) -> StampedState:
    """The state `name` in a payload. Raises PayloadError."""
    values = decode_values(message_class(name, relayed), payload)
    relay_stamp, own_stamp = values.pop("relay_stamp", None), values.pop("stamp")
    return StampedState(_state_of(name, values), own_stamp, relay_stamp)


def plain_state(name: str, payload: bytes) -> PlainState:
    """The state `name` in a drone's payload. Raises PayloadError."""
    plain = plain_of(message_class(name, False), payload)
    own_stamp, plain[0] = plain[0], CODES.get(name)
    return PlainState(name, own_stamp, plain, payload if payload[0] in _SHORT_ARRAYS else None)


def encode_relayed(message: PlainState, relay_stamp: int, encoding: Encoding) -> bytes:
    """The payload of a drone's state with an activator's stamp added in front."""
    if encoding is Encoding.JSON:
        return encode_state(StampedState(message.state, message.stamp, relay_stamp), encoding)
    if message.origin is None:
        return encode_plain([relay_stamp, message.stamp, *message.item[1:]])
    return _longer_head(message.origin[0], relay_stamp) + message.origin[1:]


@lru_cache(maxsize=1024)
def _longer_head(head: int, first: int) -> bytes:
    """The head of a short array with one more item, and that item; cached, since states of one moment share it."""
    return bytes((head + 1,)) + encode_plain(first)


def _state_of(name: str, values: dict[str, Any]) -> State:
    return STATES[name](**values) if name in STATES else MavlinkState(name, values)
