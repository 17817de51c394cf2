"""The specification's tables, made from the code: topics, payloads, words, commands, states, worked examples.

`python -m spec.tables FILE` writes them into a Markdown file, each between its markers
`<!-- generated: NAME -->` and `<!-- end -->`; a test checks that docs/protocol.md is up to date.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import is_dataclass
from typing import Any, get_args, get_type_hints

from mqttxt.drone.mavlink.guarded_parameters import GUARDED as GUARDED_PARAMETERS
from mqttxt.drone.mavlink.raw import GUARDED, MAV_CMDS, TYPED
from mqttxt.errors import ConfigurationError
from mqttxt.protocol.codec import Layout, layout_of
from mqttxt.protocol.commands import BROADCASTABLE, COMMAND
from mqttxt.protocol.fields import Binary, Constant, Finite, Integer, Items, Name, Named, Real, Scaled, Text
from mqttxt.protocol.messages import Word
from mqttxt.protocol.policies import ON_REQUEST, POLICIES, Policy
from mqttxt.protocol.states import STATE, STATES
from mqttxt.protocol.topic_table import CLOUD_SIDE, FOG_SIDE, SENSOR_SIDE, TopicRow, topics_of
from mqttxt.protocol.values import item_of, mark_of

from .examples import examples
from .pages import pages
from .schema import MESSAGES, rule_name

_UNITS = {"_m_s": "m/s", "_deg": "°", "_pct": "%", "_ms": "ms", "_s": "s", "_m": "m", "_v": "V", "_a": "A", "_hz": "Hz"}
_SMALL = {("m", 1000): "mm", ("m/s", 100): "cm/s", ("V", 1000): "mV", ("A", 100): "cA"}


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A Markdown table."""
    lines = [list(head)]
    lines.append(["---"] * len(lines[0]))
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in (*lines, *rows))


def topics() -> str:
    """The topics of every broker."""
    return "\n\n".join(
        [
            "Between ground stations and an activator, on the cloud broker:",
            _topic_table(CLOUD_SIDE),
            "Between an activator and its UAV clients, on the fog's broker:",
            _topic_table(FOG_SIDE),
            "Between sensors and the UAV client that carries their readings, on the drone's own broker:",
            _topic_table(SENSOR_SIDE),
        ]
    )


def _topic_table(rows: Iterable[TopicRow]) -> str:
    return table(
        ("topic", "from → to", "QoS", "retained", "payload", "what"),
        (
            (
                f"`{row.topic}`",
                f"{row.sender} → {row.receiver}",
                str(row.qos),
                "yes" if row.retained else "no",
                row.payload if isinstance(row.payload, str) else rule_name(row.payload),
                row.what + (" **(choice)**" if row.choice else ""),
            )
            for row in rows
        ),
    )


def messages() -> str:
    """Each message with its fields in CBOR's order, then every enumeration that the messages use."""
    classes = [*MESSAGES]
    for cls in classes:
        parts_of = [*_variants_of(cls), *_inner_messages(cls)]
        classes += [inner for inner in parts_of if inner not in classes]
    parts = [_message(cls) for cls in classes]
    return "\n\n".join([*parts, "#### Enumerations", *_enumerations(classes)])


def _message(cls: type[Any]) -> str:
    layout = layout_of(cls)
    hints = get_type_hints(cls, include_extras=True)
    rows = [
        (str(index), f"`{field.name}`", *_forms(field.name, hints[field.name]), _missing(layout, index))
        for index, field in enumerate(layout.fields)
    ]
    if layout.variant is not None:
        name, variant = layout.variant
        codes = [code for code, _, _ in variant.codes]
        said = f"{min(codes)} to {max(codes)}, its code"
        if _variants_of(cls):
            said = ", ".join(f"{code} `{label}`" for code, label, _ in variant.codes)
        last = len(layout.fields)
        rows += [
            (str(last), f"`{name}`", said, "its name", "no"),
            (f"{last + 1} …", f"the {name}'s own fields", "as listed below", "on the same level", "no"),
        ]
    where = ", ".join(f"`{topic}`" for topic in topics_of(cls))
    head = f"#### {rule_name(cls)}\n\n" + (f"On {where}. " if where else "Part of other messages. ") + _docstring(cls)
    return head + "\n\n" + table(("", "field", "CBOR", "JSON", "may be missing"), rows)


def _variants_of(cls: type[Any]) -> list[type[Any]]:
    """The bodies of a message's variants; none for commands and states, which have sections of their own."""
    variant = layout_of(cls).variant
    return [] if variant is None or variant[1] in (COMMAND, STATE) else [body for _, _, body in variant[1].codes]


def _missing(layout: Layout, index: int) -> str:
    if not layout.fields[index].optional:
        return "no"
    return "left out" if index >= layout.required and layout.variant is None else "null"


def _docstring(cls: object) -> str:
    """An object's docstring on one line."""
    return " ".join((cls.__doc__ or "").split())


def _inner_messages(cls: type[Any]) -> list[type[Any]]:
    marks = [_inner(hint) for hint in get_type_hints(cls, include_extras=True).values()]
    return [mark for mark in dict.fromkeys(marks) if isinstance(mark, type) and is_dataclass(mark)]


def _inner(hint: Any) -> Any:
    """The mark of a field's type; for a list, that of its items."""
    hint = _without_none(hint)
    mark = mark_of(hint)
    return mark_of(item_of(hint)) if isinstance(mark, Items) else mark


def _without_none(hint: Any) -> Any:
    args = get_args(hint)
    return next(arg for arg in args if arg is not type(None)) if type(None) in args else hint


def _enumerations(classes: Iterable[type[Any]]) -> list[str]:
    holders = [*classes, *STATES.values()]
    found: dict[str, type[Named]] = {}
    for cls in holders:
        for hint in get_type_hints(cls, include_extras=True).values():
            inner = _inner(hint)
            if isinstance(inner, type) and issubclass(inner, Named) and inner is not Word:
                found[inner.__name__] = inner
    return [
        f"{_docstring(enum)} " + ", ".join(f"{int(member)} `{member.label}`" for member in enum) + "."
        for enum in found.values()
    ]


def _forms(name: str, hint: Any) -> tuple[str, str]:
    """A field's form in CBOR, and in JSON; `hint` is its type or the mark itself."""
    hint = _without_none(hint)
    mark = mark_of(hint)
    unit = next((unit for ending, unit in _UNITS.items() if name.endswith(ending)), "")
    if isinstance(mark, Integer):
        return (f"{_number(mark.low)} to {_number(mark.high)}{_behind(unit)}", "the same")
    if isinstance(mark, Constant):
        return (str(mark.value), "the same")
    if isinstance(mark, Scaled):
        low, high = round(mark.low * mark.per_unit), round(mark.high * mark.per_unit)
        fine = _SMALL.get((unit, mark.per_unit)) or f"{1 / mark.per_unit:g} {unit}".rstrip()
        of_cbor, of_json = f"{low} to {high}{_behind(fine)}", f"{mark.low:.12g} to {mark.high:.12g}{_behind(unit)}"
        return (of_cbor, of_json)
    if isinstance(mark, Real):
        return ("a number or null", "the same")
    if isinstance(mark, Finite):
        return ("a finite number: integer or float", "a finite number")
    if isinstance(mark, Name):
        return ("a name (R2.1)", "the same")
    if isinstance(mark, Text):
        return (f"text of at most {mark.longest} characters", "the same")
    if isinstance(mark, Binary):
        size = f"{mark.most}" if mark.least == mark.most else f"{mark.least} to {mark.most}"
        return (f"{size} bytes", "in hexadecimal")
    if isinstance(mark, Items):
        count = f"{mark.most}" if mark.least == mark.most else f"at most {mark.most}"
        return (f"array of {count}: {_name_of(_inner(hint))}", "the same")
    if mark is bool:
        return ("true or false", "the same")
    if isinstance(mark, type) and issubclass(mark, Named):
        codes = [int(member) for member in mark]
        return (f"{min(codes)} to {max(codes)}, its code", "its name")
    return (f"array: {_name_of(mark)}", f"object: {_name_of(mark)}")


def _name_of(mark: Any) -> str:
    if isinstance(mark, Integer):
        return f"whole numbers from {_number(mark.low)} to {_number(mark.high)}"
    return rule_name(mark) if isinstance(mark, type) else _forms("", mark)[0]


def _number(value: int) -> str:
    powers = {2**16 - 1: "2^16 - 1", 2**32 - 1: "2^32 - 1", 2**53 - 1: "2^53 - 1"}
    return powers.get(value, str(value))


def _behind(unit: str) -> str:
    return f" ({unit})" if unit else ""


def words() -> str:
    """Every word with its code."""
    return table(("code", "word", "last"), ((str(int(w)), f"`{w.label}`", "yes" if w.is_last else "no") for w in Word))


def commands() -> str:
    """Every command with its code, parameters and default limit; then the composite types of their parameters."""
    inner = [cls for _, _, body in COMMAND.codes for cls in _inner_messages(body)]
    return "\n\n".join([_command_table(), *(_message(cls) for cls in inner)])


def _command_table() -> str:
    return table(
        ("code", "command", "parameters in CBOR", "in JSON", "limit", "broadcast", "what"),
        (
            (
                str(code),
                f"`{label}`",
                *_parameters(body),
                f"{body.limit_s:g} s" if isinstance(body.limit_s, float) else _docstring(body.limit_s),
                "yes" if issubclass(body, BROADCASTABLE) else "no",
                _docstring(body),
            )
            for code, label, body in COMMAND.codes
        ),
    )


def mav_cmds() -> str:
    """The MAV_CMDs that the command `mavlink` denies: always, or unless enabled."""
    typed = table(("MAV_CMD", "name", "command"), ((str(n), MAV_CMDS[n], f"`{TYPED[n]}`") for n in sorted(TYPED)))
    guarded = table(("MAV_CMD", "name", "why"), ((str(n), MAV_CMDS[n], GUARDED[n]) for n in sorted(GUARDED)))
    return f"Denied, because there is a command for it:\n\n{typed}\n\nDenied unless enabled:\n\n{guarded}"


def guarded_parameters() -> str:
    """The parameters that `set_parameter` does not set unless enabled, grouped by reason."""
    by_reason: dict[str, list[str]] = {}
    for pattern, why in GUARDED_PARAMETERS.items():
        by_reason.setdefault(why, []).append(f"`{pattern}`")
    return table(("parameters", "why"), ((", ".join(names), why) for why, names in by_reason.items()))


def states() -> str:
    """Every state with its fields and publishing policy; a state that no bundle carries has no code."""
    codes = {name: str(code) for code, name, _ in STATE.codes}
    return table(
        ("code", "state", "fields in CBOR", "in JSON", "published beyond", "at most", "what"),
        (
            (codes.get(name, "–"), f"`{name}`", *_parameters(cls), *_published(name), _docstring(cls))
            for name, cls in STATES.items()
        ),
    )


def _published(name: str) -> tuple[str, str]:
    """The change beyond which a state is published, and its highest rate; a text has no policy: each, at 5 Hz."""
    on_request = " (on request)" if name in ON_REQUEST else ""
    policy = POLICIES.get(name)
    return (f"each{on_request}", "5 Hz") if policy is None else (policy.deadband + on_request, _rate(policy))


def _rate(policy: Policy) -> str:
    return f"{1000 / policy.min_interval_ms:g} Hz"


def _parameters(cls: type[Any]) -> tuple[str, str]:
    """The fields of a command or a state, in both forms."""
    hints = get_type_hints(cls, include_extras=True)
    forms = [(field, *_forms(field.name, hints[field.name])) for field in layout_of(cls).fields]
    in_cbor = "<br>".join(f"`{f.name}`: {cbor}{', or left out' if f.optional else ''}" for f, cbor, _ in forms)
    in_json = "<br>".join(text for _, _, text in forms)
    return in_cbor or "none", in_json or "none"


def worked_examples() -> str:
    """One message of each kind in both forms, byte by byte."""
    return "\n\n".join(
        f"{example.title}, on `{example.topic}`: {len(example.cbor)} bytes of CBOR, {len(example.json)} of JSON.\n\n"
        f"```text\n{example.cbor.hex(' ')}\n{example.diagnostic}\n{example.json.decode()}\n```"
        for example in examples()
    )


SECTIONS: dict[str, Callable[[], str]] = {
    "topics": topics,
    "messages": messages,
    "words": words,
    "commands": commands,
    "mav_cmds": mav_cmds,
    "guarded_parameters": guarded_parameters,
    "states": states,
    "examples": worked_examples,
}
_BLOCK = re.compile(r"(<!-- generated: (\S+) -->\n).*?(<!-- end -->)", re.DOTALL)


def filled(text: str, sections: Mapping[str, Callable[[], str]] = SECTIONS) -> str:
    """`text` with the tables between its markers made anew; raises ConfigurationError for an unknown marker."""

    def fill(block: re.Match[str]) -> str:
        make = sections.get(block[2])
        if make is None:
            raise ConfigurationError(f"marker {block[2]!r}: expected one of {', '.join(sections)}")
        return f"{block[1]}\n{make()}\n\n{block[3]}"

    return _BLOCK.sub(fill, text)


def main(*files: str) -> None:
    """Write the tables into `files`."""
    for path in pages(files):
        path.write_text(filled(path.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
