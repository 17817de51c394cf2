"""MAVLink 1 and 2 messages in UDP datagrams, all datagrams at once (mavlink.io, "Packet Serialization")."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from pymavlink.dialects.v20 import development as dialect

from sitl.unnamed import NAMES

from ...fly.pcap import Bytes, Ints, windows

COMMANDS = {75: (28, 30), 76: (28, 30), 77: (0, 8)}
"""COMMAND_INT, COMMAND_LONG and COMMAND_ACK by id: offsets of the MAV_CMD and the target system in the payload."""
NONE = -1
_MAGIC_1, _MAGIC_2, _SIGNED, _SIGNATURE = 0xFE, 0xFD, 0x01, 13
_HEAD, _AROUND_1, _AROUND_2 = 10, 8, 12
_ID_ACK = 77


@dataclass(frozen=True)
class MessageColumns:
    """An array per field, with an entry per message, by datagram and in the order within a datagram.

    `datagram` is the index of the datagram among those given; `size` and `payload_size` are bytes. `target_system` and
    `command` are NONE for a message without them; `params` are the first three of COMMAND_INT and COMMAND_LONG, else
    NaN.
    """

    datagram: Ints
    version: Ints
    identity: Ints
    system: Ints
    component: Ints
    sequence: Ints
    crc: Ints
    size: Ints
    payload_size: Ints
    target_system: Ints
    command: Ints
    params: npt.NDArray[np.float32]


def name_of(identity: int) -> str:
    """A message's name in development.xml (common.xml and additions to come), or else as MAVLINK_12345."""
    known = dialect.mavlink_map.get(identity)
    return str(known.msgname) if known is not None else NAMES.get(identity, f"MAVLINK_{identity}")


def find_messages(data: Bytes, starts: Ints, ends: Ints) -> MessageColumns:
    """Find the messages from a datagram's first byte on, up to bytes that are no message or an incomplete one.

    Their CRCs are not checked: the frames are read as they entered their links, unchanged by these.
    """
    found: list[Ints] = []
    datagrams, at, end = np.arange(len(starts)), starts, ends
    while datagrams.size:
        head = windows(data, _HEAD, at).astype(np.int64)
        is_2 = head[:, 0] == _MAGIC_2
        size = np.where(is_2, head[:, 1] + _AROUND_2 + _SIGNATURE * (head[:, 2] & _SIGNED), head[:, 1] + _AROUND_1)
        whole = (is_2 | (head[:, 0] == _MAGIC_1)) & (at + size <= end)
        datagrams, at, end, head, size, is_2 = (a[whole] for a in (datagrams, at, end, head, size, is_2))
        version = np.where(is_2, 2, 1)
        identity = np.where(is_2, head[:, 7] | head[:, 8] << 8 | head[:, 9] << 16, head[:, 5])
        sender = [np.where(is_2, head[:, 4 + n], head[:, 2 + n]) for n in range(3)]
        payload = at + np.where(is_2, _HEAD, 6)
        found.append(np.stack([datagrams, version, identity, *sender, size, payload, head[:, 1]], axis=1))
        at = at + size
        more = at < end
        datagrams, at, end = datagrams[more], at[more], end[more]
    table = np.concatenate(found) if found else np.empty((0, 9), dtype=np.int64)
    table = table[np.argsort(table[:, 0], kind="stable")]
    datagram, version, identity, sequence, system, component, size, payload, length = (
        np.ascontiguousarray(column) for column in table.T
    )
    crc = _little_endian(windows(data, 2, payload + length))
    return MessageColumns(
        datagram=datagram,
        version=version,
        identity=identity,
        system=system,
        component=component,
        sequence=sequence,
        crc=crc,
        size=size,
        payload_size=length,
        **_contents(data, identity, payload, length),
    )


def _contents(data: Bytes, identity: Ints, payload: Ints, length: Ints) -> dict[str, npt.NDArray[Any]]:
    """The fields read from payloads. MAVLink 2 does not send zeros at the end, so bytes beyond a payload are 0."""
    target = np.full(len(identity), NONE, dtype=np.int64)
    command = target.copy()
    params = np.full((len(identity), 3), np.nan, dtype=np.float32)
    for number in np.unique(identity):
        offset = _target_offset(int(number))
        if offset is None:
            continue
        rows = np.flatnonzero(identity == number)
        where = payload[rows], length[rows]
        target[rows] = _little_endian(_field(data, *where, offset, 1))
        if number in COMMANDS:
            command[rows] = _little_endian(_field(data, *where, COMMANDS[int(number)][0], 2))
            if number != _ID_ACK:
                params[rows] = np.ascontiguousarray(_field(data, *where, 0, 12)).view("<f4")
    return {"target_system": target, "command": command, "params": params}


def _field(data: Bytes, payload: Ints, length: Ints, offset: int, width: int) -> Bytes:
    there = np.arange(offset, offset + width) < length[:, None]
    return np.where(there, windows(data, width, payload + offset), np.uint8(0))


def _target_offset(identity: int) -> int | None:
    """The offset of `target_system` in a message's payload; None for a message without one."""
    if identity in COMMANDS:
        return COMMANDS[identity][1]
    known = dialect.mavlink_map.get(identity)
    if known is None or "target_system" not in known.fieldnames:
        return None
    offset = 0
    for name, elements in zip(known.ordered_fieldnames, known.array_lengths, strict=True):
        if name == "target_system":
            break
        offset += _TYPE_SIZES[known.fieldtypes[known.fieldnames.index(name)]] * max(1, elements)
    return offset


_TYPE_SIZES = {
    **{f"{sign}int{bits}_t": bits // 8 for sign in ("", "u") for bits in (8, 16, 32, 64)},
    "char": 1,
    "float": 4,
    "double": 8,
}


def _little_endian(rows: Bytes) -> Ints:
    value = np.zeros(len(rows), dtype=np.int64)
    for column in range(rows.shape[1]):
        value |= rows[:, column].astype(np.int64) << 8 * column
    return value
