"""Files that users write: YAML, checked against a JSON schema, whose descriptions say what was expected."""

from __future__ import annotations

import json
import math
from collections import Counter
from functools import cache
from pathlib import Path
from typing import Any

import jsonschema
import yaml

from ..errors import UserError

ROOT = Path(__file__).resolve().parents[2]
MOST_VALUES = 100_000
"""The keys and values of a file, each as often as aliases repeat it: a short file could name billions."""


def read_document(path: Path, schema_file: Path) -> dict[str, Any]:
    """Read a file; all keys are text. Raises UserError that names file, field, value and what was expected."""
    try:
        document = _text_keys(yaml.load(path.read_text(encoding="utf-8"), Loader=_Loader))
    except yaml.MarkedYAMLError as error:
        line = f" line {error.problem_mark.line + 1}:" if error.problem_mark else ""
        raise UserError(f"{shown(path)}:{line} {error.problem}: expected YAML, each key once") from error
    except RecursionError:
        raise UserError(f"{shown(path)}: nested too deep, or within itself: expected a readable YAML file") from None
    except (OSError, ValueError, TypeError, yaml.YAMLError) as error:
        why = error.strerror if isinstance(error, OSError) else " ".join(str(error).split())
        raise UserError(f"{shown(path)}: {why}: expected a readable YAML file") from error
    schema = _schema(schema_file)
    first = min(
        jsonschema.Draft202012Validator(schema).iter_errors(document),
        key=lambda error: (len(error.path), str(error.path)),
        default=None,
    )
    if first is not None:
        raise UserError(f"{shown(path)}: {_said(first, schema)}")
    found: dict[str, Any] = document
    return found


def shown(path: Path) -> str:
    """A path as one would type it: relative to the repository if it is inside."""
    full = path.resolve()
    return str(full.relative_to(ROOT)) if full.is_relative_to(ROOT) else str(path)


@cache
def _schema(path: Path) -> dict[str, Any]:
    schema: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return schema


_MERGE = "tag:yaml.org,2002:merge"
"""The tag of `<<: *other`; the mapping's own keys replace those of `other`."""


class _Loader(yaml.SafeLoader):
    """A YAML loader that rejects duplicate keys instead of taking the last; 1 and '1' are the same key.

    It counts what aliases repeat, and rejects more than MOST_VALUES.
    """

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._count = 0
        self._counts: dict[str, int] = {}
        """The keys and values behind each anchor."""

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]
        before = self._count
        is_alias = isinstance(event, yaml.AliasEvent)
        self._count += self._counts.get(event.anchor, 1) if is_alias else 1
        if self._count > MOST_VALUES:
            problem = f"more than {MOST_VALUES} keys and values, with those that aliases repeat"
            raise yaml.composer.ComposerError(None, None, problem, event.start_mark)
        node = super().compose_node(parent, index)
        if not is_alias and event.anchor is not None:
            self._counts[event.anchor] = self._count - before
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        keys = [str(self.construct_object(key, deep=True)) for key, _ in node.value if key.tag != _MERGE]
        twice = next((key for key, times in Counter(keys).items() if times > 1), None)
        if twice is not None:
            raise yaml.constructor.ConstructorError(None, None, f"{twice!r} is there twice", node.start_mark)
        return super().construct_mapping(node, deep)


def _float(loader: yaml.SafeLoader, node: yaml.ScalarNode) -> float | str:
    """Keep `.nan` and `.inf` as text: NaN would pass a schema's bounds."""
    number = loader.construct_yaml_float(node)
    return number if math.isfinite(number) else str(node.value)


_Loader.add_constructor("tag:yaml.org,2002:float", _float)


def _text_keys(value: Any) -> Any:
    """Turn keys that are numbers into text, as in JSON: a schema has patterns only for text."""
    if isinstance(value, dict):
        return {str(key): _text_keys(inner) for key, inner in value.items()}
    return [_text_keys(inner) for inner in value] if isinstance(value, list) else value


def _said(error: jsonschema.ValidationError, whole: dict[str, Any]) -> str:
    """An error's field, value, and what was expected, by the schema's own descriptions."""
    place = _field_name(error.absolute_path)
    schema = error.schema if isinstance(error.schema, dict) else {}
    if error.validator == "additionalProperties" and isinstance(error.instance, dict):
        known = schema["properties"]
        unknown = next(key for key in error.instance if key not in known)
        inner = _field_name([*error.absolute_path, unknown])
        return f"{inner}: {error.instance[unknown]!r}: unknown field: expected one of {', '.join(known)}"
    if error.validator == "required" and isinstance(error.instance, dict):
        missing = next(key for key in schema["required"] if key not in error.instance)
        expected = _expected(schema, missing, whole)
        return f"{_field_name([*error.absolute_path, missing])}: missing: expected {expected}"
    return f"{place or 'the file'}: {_value(error.instance)}: expected {schema.get('description', error.message)}"


def _expected(schema: dict[str, Any], field: str, whole: dict[str, Any]) -> str:
    inner = schema["properties"][field]
    if "$ref" in inner:
        inner = whole["$defs"][inner["$ref"].rsplit("/", 1)[1]]
    return str(inner.get("description", "it"))


def _value(instance: Any) -> str:
    text = repr(instance)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _field_name(path: Any) -> str:
    """A field's name as `links.air.up.rate`, `events[0].at`."""
    name = ""
    for part in path:
        text = part if not isinstance(part, str) or part.isprintable() else repr(part)
        name += f"[{part}]" if isinstance(part, int) else f"{'.' if name else ''}{text}"
    return name
