"""The schemas of both payload forms, made from the messages themselves: JSON Schema and CDDL (RFC 8610).

`python -m spec.schema FOLDER…` writes them; a test checks that the repository's copies are up to date.
"""

from __future__ import annotations

import json
import sys
from typing import Any

from mqttxt.protocol import bulk, bundles, control, logs, messages, parameters, plans, rankings, readings
from mqttxt.protocol.codec import FieldLayout, Layout, layout_of
from mqttxt.protocol.fields import VERSION, Binary, Constant, Finite, Integer, Items, Name, Named, Real, Scaled, Text
from mqttxt.protocol.state_payload import message_class
from mqttxt.protocol.states import STATES

from .pages import folders

MESSAGES: tuple[type[Any], ...] = (
    messages.BeaconMessage,
    messages.CommandMessage,
    messages.ResultMessage,
    messages.FogResultMessage,
    messages.Presence,
    control.DroneRecord,
    messages.FogPresence,
    control.Registration,
    control.DroneLease,
    control.Grant,
    rankings.SelectMessage,
    rankings.PsmiMessage,
    rankings.QodsMessage,
    readings.ReadingMessage,
    readings.ReadingAck,
    bulk.BulkAsk,
    bulk.BulkAnswer,
    plans.PlanObject,
    parameters.ParametersObject,
    logs.LogsObject,
    bundles.DroneBundle,
    bundles.FogBundle,
)


def _every_message() -> list[type[Any]]:
    states = [message_class(name, relayed) for name in STATES for relayed in (False, True)]
    return [*MESSAGES, *states]


def json_schema() -> dict[str, Any]:
    """The JSON Schema (draft 2020-12) of every message, by name under `$defs`."""
    definitions: dict[str, Any] = {}
    for cls in _every_message():
        _define(cls, definitions)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": f"urn:mqttxt:payload:{VERSION}",
        "title": f"MQTT-XT payloads in JSON, version {VERSION}",
        "$defs": dict(sorted(definitions.items())),
    }


def _define(cls: type[Any], definitions: dict[str, Any]) -> None:
    layout = layout_of(cls)
    fields = {field.name: _json_field(field.mark, definitions) for field in layout.fields}
    required = [field.name for field in layout.fields if not field.optional]
    definitions[cls.__name__] = {}
    if layout.variant is None:
        definitions[cls.__name__] = _object(fields, required)
        return
    name, variant = layout.variant
    choices = []
    for _, label, body in variant.codes:
        own = {field.name: _json_field(field.mark, definitions) for field in layout_of(body).fields}
        needed = [field.name for field in layout_of(body).fields if not field.optional]
        choices.append(_object({**fields, name: {"const": label}, **own}, [*required, name, *needed]))
    definitions[cls.__name__] = {"oneOf": choices}


def _object(fields: dict[str, Any], required: list[str]) -> dict[str, Any]:
    return {"type": "object", "properties": fields, "required": required, "additionalProperties": False}


def _json_field(mark: Any, definitions: dict[str, Any]) -> dict[str, Any]:
    if isinstance(mark, Integer):
        return {"type": "integer", "minimum": mark.low, "maximum": mark.high}
    if isinstance(mark, Constant):
        return {"const": mark.value}
    if isinstance(mark, Scaled):
        return {"type": "number", "minimum": mark.low, "maximum": mark.high}
    if isinstance(mark, Real):
        return {"type": ["number", "null"], "minimum": -mark.largest, "maximum": mark.largest}
    if isinstance(mark, Finite):
        return {"type": "number"}
    if isinstance(mark, Name):
        return {"type": "string", "pattern": f"^{mark.pattern}$"}
    if isinstance(mark, Text):
        return {"type": "string", "maxLength": mark.longest}
    if isinstance(mark, Binary):
        return {"type": "string", "pattern": f"^([0-9a-f]{{2}}){{{mark.least},{mark.most}}}$"}
    if isinstance(mark, Items):
        return {
            "type": "array",
            "minItems": mark.least,
            "maxItems": mark.most,
            "items": _json_field(mark.of, definitions),
        }
    if mark is bool:
        return {"type": "boolean"}
    if issubclass(mark, Named):
        return {"enum": [member.label for member in mark]}
    _define(mark, definitions)
    return {"$ref": f"#/$defs/{mark.__name__}"}


def cddl() -> str:
    """The CDDL of every message's CBOR form; a state's rule ends in `-state`."""
    rules: dict[str, str] = {}
    for cls in _every_message():
        _rule(cls, rules)
    head = f"; MQTT-XT payloads in CBOR, version {VERSION}: positional arrays, trailing nulls left out.\n"
    return head + "\n" + "\n".join(rules.values())


def rule_name(cls: type[Any]) -> str:
    """A message's name in the CDDL and in the specification."""
    words = "".join(f"-{c.lower()}" if c.isupper() else c for c in cls.__name__).lstrip("-")
    return words.removesuffix("-message")


def _rule(cls: type[Any], rules: dict[str, str]) -> str:
    name = rule_name(cls)
    layout = layout_of(cls)
    if name in rules:
        return name
    rules[name] = ""
    items = [_cddl_item(layout, index, field, rules) for index, field in enumerate(layout.fields)]
    if layout.variant is None:
        rules[name] = f"{name} = [{', '.join(items)}]\n"
        return name
    _, variant = layout.variant
    choices = [_cddl_choice(code, label, body, rules) for code, label, body in variant.codes]
    rules[name] = f"{name} = [{', '.join([*items, ''])}({' // '.join(choices)})]\n"
    return name


def _cddl_choice(code: int, label: str, body: type[Any], rules: dict[str, str]) -> str:
    layout = layout_of(body)
    own = [_cddl_item(layout, index, field, rules) for index, field in enumerate(layout.fields)]
    return ", ".join([f"{label}: {code}", *own])


def _cddl_item(layout: Layout, index: int, field: FieldLayout, rules: dict[str, str]) -> str:
    item = f"{field.name}: {_cddl_type(field.mark, rules)}"
    if field.optional:
        item += " / null"
    return f"? {item}" if index >= layout.required and layout.variant is None else item


def _cddl_type(mark: Any, rules: dict[str, str]) -> str:
    if isinstance(mark, Integer):
        return f"{mark.low}..{mark.high}"
    if isinstance(mark, Constant):
        return str(mark.value)
    if isinstance(mark, Scaled):
        return f"{round(mark.low * mark.per_unit)}..{round(mark.high * mark.per_unit)}"
    if isinstance(mark, Real):
        return "number / null"
    if isinstance(mark, Finite):
        return "int / float"
    if isinstance(mark, Name):
        return f'tstr .regexp "{mark.pattern}"'
    if isinstance(mark, Text):
        return f"tstr .size (0..{4 * mark.longest})"
    if isinstance(mark, Binary):
        return f"bstr .size ({mark.least}..{mark.most})"
    if isinstance(mark, Items):
        return f"[{mark.least}*{mark.most} {_cddl_type(mark.of, rules)}]"
    if mark is bool:
        return "bool"
    if issubclass(mark, Named):
        return "(" + " / ".join(str(int(member)) for member in mark) + ")"
    return _rule(mark, rules)


def main(*directories: str) -> None:
    """Write both schemas into `directories`."""
    for folder in folders(directories):
        (folder / f"payload-v{VERSION}.schema.json").write_text(json.dumps(json_schema(), indent=1) + "\n")
        (folder / f"payload-v{VERSION}.cddl").write_text(cddl())


if __name__ == "__main__":
    main(*sys.argv[1:])
