"""The specification's tables: made from the code, complete, and what stands in docs/protocol.md."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cbor2
import pytest

from mqttxt.errors import ConfigurationError
from mqttxt.protocol.codec import decode
from mqttxt.protocol.logs import LogsObject
from mqttxt.protocol.messages import CommandMessage, Word
from mqttxt.protocol.parameters import ParametersObject
from mqttxt.protocol.plans import PlanObject
from mqttxt.protocol.policies import POLICIES
from mqttxt.protocol.states import STATES, Battery, Groundspeed, Heading, Home, Location, VitalState
from mqttxt.protocol.topic_table import CLOUD_SIDE, FOG_SIDE, SENSOR_SIDE, TopicRow, topics_of
from mqttxt.protocol.topics import REVOKED, CloudSide, FogSide, SensorSide, station_reachable
from spec import schema, tables
from spec.examples import STATION, examples, notation
from tests.simulation.strategies import as_sent

PROTOCOL = Path(__file__).resolve().parents[3] / "docs" / "protocol.md"
LETTERS = {"X": "1", "Y": "2", "Z": "battery", "C": "goto", "G": "alpha", "S": "3", "K": "temperature"}
ARGUMENTS = {"drone": 2, "name": "battery", "command": "goto", "sensor": 3, "kind": "temperature"}
NO_TOPICS = {"parse", "local_root"}


def built(side: CloudSide | FogSide) -> set[str]:
    """Every topic that a side can build."""
    found = set()
    for name, member in inspect.getmembers(type(side)):
        if name.startswith("_") or name.endswith("_filters") or name in NO_TOPICS:
            continue
        value = getattr(side, name)
        if callable(member):
            value = value(*(ARGUMENTS[parameter] for parameter in inspect.signature(value).parameters))
        found.add(value)
    return found


@pytest.mark.parametrize(("side", "rows"), [(CloudSide(1), CLOUD_SIDE), (FogSide(), FOG_SIDE)], ids=["cloud", "fog"])
def test_every_topic_of_the_table_is_one(side: CloudSide | FogSide, rows: tuple[TopicRow, ...]) -> None:
    for row in rows:
        if row.topic != REVOKED:
            side.parse(as_sent(row, LETTERS))


def test_every_topic_of_the_drones_own_broker_is_in_the_table() -> None:
    side = SensorSide()
    assert [as_sent(row, LETTERS) for row in SENSOR_SIDE] == [side.sensor(3, "temperature"), side.ack, REVOKED]
    assert side.parse("sensor3/temperature") == (3, "temperature")


def test_every_topic_that_can_be_built_is_in_the_table_once() -> None:
    cloud, fog = ([as_sent(row, LETTERS) for row in side] for side in (CLOUD_SIDE, FOG_SIDE))
    assert sorted(cloud) == sorted({*built(CloudSide(1)), station_reachable("alpha")})
    assert sorted(fog) == sorted(built(FogSide()))


def test_every_message_has_a_topic_and_a_schema() -> None:
    carried = {row.payload for row in (*CLOUD_SIDE, *FOG_SIDE) if not isinstance(row.payload, str)}
    assert carried == {*schema.MESSAGES} - {PlanObject, ParametersObject, LogsObject}  # carried in pieces
    assert topics_of(CommandMessage)[0].startswith("fogX/")


def test_what_is_kept_by_the_broker_is_never_at_qos_0() -> None:
    assert all(row.qos == 1 for row in (*CLOUD_SIDE, *FOG_SIDE) if row.retained)


def test_the_specifications_tables_are_made_from_the_code() -> None:
    text = PROTOCOL.read_text(encoding="utf-8")
    assert text == tables.filled(text), "run make docs"
    for name in tables.SECTIONS:
        assert f"<!-- generated: {name} -->" in text


def test_a_marker_that_nothing_fills_is_named() -> None:
    with pytest.raises(ConfigurationError, match="marker 'weather': expected one of topics"):
        tables.filled("<!-- generated: weather -->\n<!-- end -->")


def test_the_files_given_are_written(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- generated: words -->\nold\n<!-- end -->\nafter\n")
    tables.main(str(page))
    written = page.read_text()
    assert "| 3 | `completed` | yes |" in written
    assert "old" not in written
    assert (written.startswith("before\n"), written.endswith("<!-- end -->\nafter\n")) == (True, True)


@pytest.mark.parametrize("cls", schema.MESSAGES, ids=lambda cls: cls.__name__)
def test_every_field_of_a_message_is_in_its_table(cls: type[Any]) -> None:
    shown = tables.messages().split(f"#### {schema.rule_name(cls)}\n")[1].split("####")[0]
    for field in cls.__dataclass_fields__:
        assert f"| `{field}` |" in shown


def test_states_are_told_with_their_deadband_and_rate() -> None:
    rows = {row.split("`")[1]: row for row in tables.states().splitlines()[2:]}
    assert set(rows) == set(STATES)
    assert "`heading_deg`: 0 to 35999 (0.01 °) | 0 to 359.99 (°) | 5° | 1 Hz" in rows["heading"]
    assert "| any change | 10 Hz |" in rows["armed"]


@pytest.mark.parametrize(
    ("old", "at", "beyond"),
    [
        (Battery(50), lambda by: Battery(50 + round(by)), Battery(49)),
        (Heading(10.0), lambda by: Heading(10.0 + by), None),
        (Groundspeed(10.0), lambda by: Groundspeed(10.0 + by), None),
        (Location(47, 8, 488, 0), lambda by: Location(47, 8, 488 + by, 0), None),
        (Location(47, 8, 488, 0), lambda by: Location(47, 8, 488, by), None),
        (Home(47, 8, 488), lambda by: Home(47, 8, 488 + by), None),
    ],
)
def test_a_deadband_in_words_is_the_one_that_is_kept(
    old: VitalState, at: Callable[[float], VitalState], beyond: VitalState | None
) -> None:
    """Just beyond the words it is exceeded, and at them it is not."""
    policy = POLICIES[old.name]
    words = re.match(r"([0-9.]+)", policy.deadband)
    assert words is not None
    most = float(words[1])
    assert not policy.exceeds(old, at(most))
    assert policy.exceeds(old, at(most + (1 if isinstance(old, Battery) else 0.01)))
    assert beyond is None or policy.exceeds(old, beyond)


def test_the_meaning_of_every_last_word_is_told() -> None:
    outcomes = PROTOCOL.read_text(encoding="utf-8").split("| word | says |")[1].split("\n\n")[0]
    assert [word.label for word in Word if word.is_last and f"`{word.label}" not in outcomes] == []


def test_worked_examples_are_messages_on_their_topics() -> None:
    rows = {as_sent(row, LETTERS).replace("/goto", "/C"): row for row in (*CLOUD_SIDE, *FOG_SIDE)}
    for example in examples():
        topic = re.sub(r"(commands_result)/\w+$", r"\1/C", re.sub(r"state/\w+$", "state/battery", example.topic))
        cls = rows[topic].payload
        if not isinstance(cls, str):
            assert decode(cls, example.cbor) == decode(cls, example.json)
        assert bytes.fromhex(example.cbor.hex(" ")) == example.cbor
        assert example.diagnostic == notation(cbor2.loads(example.cbor))
    command = next(e for e in examples() if e.topic == "fog1/drone2/commands")
    assert cbor2.loads(command.cbor)[:4] == [1, STATION, 7, 0xF061]


def test_diagnostic_notation_is_that_of_the_rfc() -> None:
    assert notation([1, None, True, 'a"\\', [False]]) == '[1, null, true, "a\\"\\\\", [false]]'
