"""The conformance kit's rules are those of the specification, and its own reading of payloads agrees with the codec."""

from __future__ import annotations

import re
from pathlib import Path

import cbor2
import pytest

from mqttxt.errors import PayloadError
from mqttxt.protocol.bulk import ANSWER, BulkAnswer, Refused
from mqttxt.protocol.bundles import drone_bundle
from mqttxt.protocol.codec import decode, encode, layout_of
from mqttxt.protocol.commands import COMMANDS, Takeoff
from mqttxt.protocol.control import DroneLease, DroneRecord, Grant, Registration
from mqttxt.protocol.messages import (
    BeaconMessage,
    CommandMessage,
    FogPresence,
    FogResultMessage,
    Presence,
    ResultMessage,
    Word,
)
from mqttxt.protocol.rankings import PsmiMessage, QodsMessage
from mqttxt.protocol.readings import ReadingAck, ReadingKey
from mqttxt.protocol.states import STATES, Armed, Battery, Mission
from mqttxt.protocol.values import Encoding
from mqttxt_conformance import activator, gs, shapes, uav
from mqttxt_conformance import fields as shape_fields
from mqttxt_conformance.registry import Broken, Finding, Rule, Verdict, check_all, expect
from mqttxt_conformance.report import as_json, count

SPECIFICATION = Path(__file__).resolve().parents[3] / "docs" / "protocol.md"
ALL = [*uav.rules(), *activator.rules(), *gs.rules()]

MESSAGES = {
    "presence": Presence(session=7, up=True),
    "beacon": BeaconMessage(session=7, now_ms=1, nonce=2, held_ms=3),
    "result": ResultMessage(gs_session=1, seq=2, session=3, stamp=4, word=Word.DENIED, reason="retained"),
    "fog-result": FogResultMessage(gs_session=1, seq=2, session=3, stamp=4, roster=()),
    "drone-record": DroneRecord(activator_session=1, up=True, drone_session=2),
    "fog-presence": FogPresence(session=1, up=False),
    "registration": Registration(name="g", session=1, nonce=2, lease_s=30),
    "drone-lease": DroneLease(activator_session=1, drone_session=2, nonce=3, bound=True),
    "grant": Grant(gs_session=1, drone_session=2, until_ms=3),
    "command": CommandMessage(gs_session=1, seq=2, executor_session=3, limit_s=5, command=Takeoff(10)),
    "reading-ack": ReadingAck(readings=(ReadingKey(sensor=4, boot=5, seq=6),)),
    "psmi": PsmiMessage(gs_session=1, seq=2, session=3, stamp=4, listed=(), left_out=()),
    "qods": QodsMessage(session=3, stamp=4, ranking=()),
    "bulk-answer": BulkAnswer(gs_session=1, kind="plan", nonce=2, answer=Refused("unknown_kind")),
}


@pytest.mark.parametrize("one", ALL, ids=lambda one: f"{one.role}-{one.name}")
def test_a_rule_names_numbers_of_the_specification_and_says_what_it_checks(one: Rule) -> None:
    known = set(re.findall(r"^- (R\d+\.\d+) ", SPECIFICATION.read_text(), re.MULTILINE))
    assert set(one.numbers) <= known
    assert one.numbers
    assert one.statement.endswith(".")


def test_rule_names_are_unique_within_a_role() -> None:
    names = [(one.role, one.name) for one in ALL]
    assert len(names) == len(set(names))


@pytest.mark.parametrize("kind", sorted(shape_fields.MESSAGES))
def test_the_kit_knows_every_field_in_its_place(kind: str) -> None:
    own = [name for name in shape_fields.MESSAGES[kind] if name != shape_fields.OPEN_ENDED.get(kind)]
    assert own == [field.name for field in layout_of(type(MESSAGES[kind])).fields]


def test_the_kit_knows_every_state_and_command() -> None:
    assert {name: [*fields] for name, fields in shape_fields.STATES.items()} == {
        name: [field.name for field in layout_of(cls).fields] for name, cls in STATES.items()
    }
    assert shape_fields.COMMANDS[1:] == tuple(COMMANDS)
    assert shape_fields.WORDS[1:] == tuple(word.label for word in Word)
    assert shape_fields.ANSWERS[1:] == tuple(name for _, name, _ in ANSWER.codes)


@pytest.mark.parametrize("encoding", [Encoding.CBOR, Encoding.JSON])
def test_a_bundle_is_its_states(encoding: Encoding) -> None:
    states = (Battery(50), Armed(True))
    payload = encode(drone_bundle(states, 7), encoding)
    alone = [(name, shapes.read_state(name, single, relayed=False)) for name, single in shapes.unbundled(payload)]
    assert alone == [("battery", {"stamp": 7, "remaining_pct": 50}), ("armed", {"stamp": 7, "armed": True})]


@pytest.mark.parametrize("encoding", [Encoding.CBOR, Encoding.JSON])
@pytest.mark.parametrize("mission", [None, bytes(range(16))])
def test_the_hash_of_a_state_may_be_absent(mission: bytes | None, encoding: Encoding) -> None:
    payload = encode(drone_bundle((Mission(2, 1, 5, mission),), 7), encoding)
    ((name, single),) = shapes.unbundled(payload)
    known = {} if mission is None else {"mission": mission if encoding is Encoding.CBOR else mission.hex()}
    assert shapes.read_state(name, single, relayed=False) == {
        "stamp": 7,
        "current": 2,
        "reached": 1,
        "total": 5,
        **known,
    }


@pytest.mark.parametrize(
    "payload",
    [b"{}", cbor2.dumps([1]), cbor2.dumps([1, [[99, 1]]]), cbor2.dumps([1, [5]]), cbor2.dumps([1, [[-1, 1]]])],
)
def test_a_bundle_that_is_none_is_broken(payload: bytes) -> None:
    with pytest.raises(Broken):
        shapes.unbundled(payload)


@pytest.mark.parametrize("encoding", [Encoding.CBOR, Encoding.JSON])
@pytest.mark.parametrize("kind", sorted(shape_fields.MESSAGES))
def test_what_the_codec_writes_is_read_as_it_was_meant(kind: str, encoding: Encoding) -> None:
    message = MESSAGES[kind]
    fields = shapes.read(kind, encode(message, encoding))
    for name, value in fields.items():
        if hasattr(message, name) and isinstance(value, int) and name != "limit_s":
            assert value == getattr(message, name)
    if kind == "result":
        assert fields["word"] == "denied"
    if kind == "command":
        assert fields["command"] == "takeoff"
    if kind == "bulk-answer":
        assert fields["answer"] == "refused"


@pytest.mark.parametrize("kind", sorted(set(shape_fields.MESSAGES) - set(shape_fields.OPEN_ENDED)))
def test_what_the_codec_refuses_is_broken_here_too(kind: str) -> None:
    row = cbor2.loads(encode(MESSAGES[kind]))
    spoilt = [[*row, *[1] * 20], row[:1], [-1, *row[1:]], [*row[:1], 1.5, *row[2:]], {"a": 1}]
    for plain in spoilt:
        payload = cbor2.dumps(plain)
        with pytest.raises(PayloadError):
            decode(type(MESSAGES[kind]), payload)
        with pytest.raises(Broken):
            shapes.read(kind, payload)


async def test_each_rule_gets_its_verdict_and_the_others_go_on() -> None:
    async def kept(kit: object) -> str:
        """Is kept."""
        return "as it should be"

    async def broken(kit: object) -> str:
        """Is broken."""
        expect(False, "came 1, expected 2")
        return ""

    rules = [Rule("uav", check.__name__, ("R1.1",), "S.", check) for check in (broken, kept)]
    told: list[Finding] = []
    found = await check_all(rules, object(), told.append)
    assert [(one.verdict, one.evidence) for one in found] == [
        (Verdict.FAIL, "came 1, expected 2"),
        (Verdict.PASS, "as it should be"),
    ]
    assert told == found
    assert count(found, Verdict.FAIL) == 1
    assert '"verdict": "fail"' in as_json("uav", found)
