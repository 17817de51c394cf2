"""metrics.json against its schema: what breaks it is named with its place, also within what the schema refers to."""

from __future__ import annotations

import json
import types
from pathlib import Path
from typing import Any, get_args, get_origin, get_type_hints, is_typeddict

import pytest

from testbed.fly.results import METRICS, read_json
from testbed.numbers.metrics.series import SCHEMA, schema_error
from testbed.numbers.written import Metrics, PairedTestEntry, SpreadEntry
from tests.handmade.finished import both, finished


@pytest.mark.parametrize(
    ("place", "value", "said"),
    [
        (["arm"], 1, "$.arm: 1 is not of type 'string'"),
        (["notes"], [1], "$.notes[0]: 1 is not of type 'string'"),
        (
            ["protocols", "mqttxt", "attempts", 0, "packets"],
            "many",
            "$.protocols.mqttxt.attempts[0].packets: 'many' is not of type 'integer'",
        ),
        (
            ["protocols", "mavlink", "attempts", 0, "mavlink", "streams", 0, "rate_hz"],
            -1,
            "$.protocols.mavlink.attempts[0].mavlink.streams[0].rate_hz: -1 is less than the minimum of 0",
        ),
        (["protocols", "mqttxt", "sent"], 7, "$.protocols.mqttxt: Additional properties are not allowed"),
    ],
)
def test_what_breaks_the_schema_is_named_with_its_place(
    place: list[Any], value: object, said: str, tmp_path: Path
) -> None:
    document = read_json(finished(tmp_path, *both()).path / METRICS)
    assert schema_error(document) is None
    *way, last = place
    part = document
    for step in way:
        part = part[step]
    part[last] = value
    assert (schema_error(document) or "").startswith(said)


def _fields(kind: Any, part: Any, definitions: dict[str, Any], where: str = "$") -> dict[str, list[set[str]]]:
    """By place of each object with names of its own: those that the type and the schema require, and all of each."""
    if isinstance(kind, types.UnionType):
        several = [one for one in get_args(kind) if one is not types.NoneType]
        kind = several[0] if len(several) == 1 else None
    while "$ref" in part or "oneOf" in part:
        if "$ref" in part:
            part = definitions[part["$ref"].removeprefix("#/$defs/")]
        else:
            part = next(one for one in part["oneOf"] if one != {"type": "null"})
    if is_typeddict(kind):
        own = [set(kind.__required_keys__), set(kind.__required_keys__ | kind.__optional_keys__)]
        found = {where: [*own, set(part["required"]), set(part["properties"])]}
        for name, hint in get_type_hints(kind).items():
            found |= _fields(hint, part["properties"].get(name, {}), definitions, f"{where}.{name}")
        return found
    if get_origin(kind) is dict:
        return _fields(get_args(kind)[1], part.get("additionalProperties", {}), definitions, f"{where}.*")
    return _fields(get_args(kind)[0], part["items"], definitions, f"{where}[]") if get_origin(kind) is list else {}


def test_the_types_of_the_document_have_the_schemas_fields() -> None:
    schema = json.loads(SCHEMA.read_text(encoding="utf-8"))
    definitions = schema["$defs"]
    found = _fields(Metrics, schema, definitions)
    found |= _fields(SpreadEntry, definitions["spread"], definitions, "spread")
    found |= _fields(PairedTestEntry, definitions["test"], definitions, "test")
    for where, (required, all_, required_there, all_there) in found.items():
        assert (where, required, all_) == (where, required_there, all_there)
    assert len(found) > 30
