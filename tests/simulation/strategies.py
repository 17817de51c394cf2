"""Hypothesis strategies for tests of wire formats and roles: any message, and traffic that passes the first checks."""

from __future__ import annotations

import re
from functools import cache
from typing import Any

import cbor2
from hypothesis import strategies as st

from mqttxt.core.effects import Inbound
from mqttxt.protocol.codec import encode, layout_of
from mqttxt.protocol.commands import Offboard
from mqttxt.protocol.fields import (
    FLOAT32_MAX,
    Binary,
    Constant,
    Finite,
    Integer,
    Items,
    Name,
    Named,
    Real,
    Scaled,
    Text,
)
from mqttxt.protocol.parameters import Parameter, ParameterType
from mqttxt.protocol.state_payload import message_class
from mqttxt.protocol.states import STATES
from mqttxt.protocol.topic_table import TopicRow
from mqttxt.protocol.values import Encoding

PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5) | st.binary(max_size=5),
    lambda inner: st.lists(inner, max_size=9) | st.dictionaries(st.text(max_size=5), inner, max_size=5),
    max_leaves=12,
)
PAYLOADS = st.binary(max_size=40) | PLAIN.map(cbor2.dumps) | st.binary(max_size=20).map(lambda tail: b"{" + tail)
"""Bytes that mostly are no message."""


def values(mark: Any, known: tuple[int, ...] = ()) -> st.SearchStrategy[Any]:
    """Any value of a field; whole numbers are often one of `known`, or the largest."""
    if isinstance(mark, Integer):
        often = [number for number in (*known, mark.high) if mark.low <= number <= mark.high]
        anything = st.integers(mark.low, mark.high)
        return st.sampled_from(often) | anything if known else anything
    if isinstance(mark, Constant):
        return st.just(mark.value)
    if isinstance(mark, Scaled):
        low, high = round(mark.low * mark.per_unit), round(mark.high * mark.per_unit)
        return st.integers(low, high).map(lambda ticks: ticks / mark.per_unit)
    if isinstance(mark, Name):
        names = st.from_regex(mark.pattern, fullmatch=True, alphabet=st.characters(codec="ascii"))
        return names.map(lambda name: name[: mark.longest])
    if isinstance(mark, Text):
        return st.text(max_size=mark.longest)
    if isinstance(mark, Binary):
        return st.binary(min_size=mark.least, max_size=mark.most)
    if isinstance(mark, Items):
        most = mark.least or min(5, mark.most)
        return st.lists(values(mark.of, known), min_size=mark.least, max_size=most).map(tuple)
    if isinstance(mark, Real):
        return st.none() | st.floats(-mark.largest, mark.largest, width=32)
    if isinstance(mark, Finite):
        return st.integers(-(2**53), 2**53).map(float) | st.floats(allow_nan=False, allow_infinity=False)
    if mark is bool:
        return st.booleans()
    if issubclass(mark, Named):
        return st.sampled_from(list(mark))
    return messages(mark, known)


@cache
def messages(cls: type[Any], known: tuple[int, ...] = ()) -> st.SearchStrategy[Any]:
    """Any message of a class."""
    layout = layout_of(cls)
    fields = {
        f.name: values(f.mark, known) if not f.optional else st.none() | values(f.mark, known) for f in layout.fields
    }
    if layout.variant is not None:
        name, variant = layout.variant
        fields[name] = st.one_of([messages(body, known) for _, _, body in variant.codes])
    if cls is Offboard:
        kinds = [{"velocity": fields.pop("velocity")}, {"attitude": fields.pop("attitude")}]
        chosen = [{name: strategy.filter(bool) for name, strategy in kind.items()} for kind in kinds]
        return st.one_of([st.builds(cls, **fields, **kind) for kind in chosen])
    if cls is Parameter:
        return st.builds(_typed, fields["name"], fields["type"], fields["value"]).filter(bool)
    return st.builds(cls, **fields)


def _typed(name: str, kind: ParameterType, value: float | None) -> Parameter | None:
    """A parameter with a value that its type can hold, or None."""
    if kind.span is not None:
        return Parameter(name, kind, kind.span[int(value or 0) % len(kind.span)])
    return None if value is not None and abs(value) > FLOAT32_MAX else Parameter(name, kind, value)


def as_sent(row: TopicRow, letters: dict[str, str]) -> str:
    """A row's topic with numbers and names for its letters."""
    return re.sub(r"(?<=fog|one|sor)[XYS]|(?<=/)[ZCKG](?=/|$)", lambda letter: letters[letter[0]], row.topic)


def inbound(rows: tuple[TopicRow, ...], known: tuple[int, ...]) -> st.SearchStrategy[Inbound]:
    """A message on a topic of the table or on none, whose payload belongs there or is arbitrary.

    `known` are sessions, nonces and times that mean something to the receiver.
    """
    return st.one_of([_on(row, known) for row in rows]) | st.builds(
        Inbound, st.text(max_size=30), PAYLOADS, st.integers(0, 2), st.booleans()
    )


def _on(row: TopicRow, known: tuple[int, ...]) -> st.SearchStrategy[Inbound]:
    names = st.sampled_from([*STATES, "arm", "goto", "malformed", "mavlink/ATTITUDE", "x" * 65_510]) | st.text(
        max_size=8
    )

    @st.composite
    def build(draw: st.DrawFn) -> Inbound:
        name = draw(names)
        drone = str(draw(st.sampled_from([1, 1, 1, 2, 250])))
        topic = as_sent(row, {"X": "1", "Y": drone, "S": "3", **dict.fromkeys("ZCKG", name)})
        payload = draw(_payload_of(row, name, known) | PAYLOADS)
        return Inbound(topic, payload, draw(st.integers(0, 1)), draw(st.booleans()))

    return build()


def _payload_of(row: TopicRow, name: str, known: tuple[int, ...]) -> st.SearchStrategy[bytes]:
    cls = row.payload
    if isinstance(cls, str):
        if name not in STATES:
            return st.binary(max_size=30)
        cls = message_class(name, row.topic.startswith("fogX"))
    return st.builds(encode, messages(cls, known), st.sampled_from(Encoding))
