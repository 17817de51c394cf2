"""Files that people write: what YAML can say that a schema would not notice."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from testbed.errors import UserError
from testbed.plan.documents import read_document

SCHEMA: dict[str, Any] = {
    "type": "object",
    "description": "whole numbers by name",
    "additionalProperties": {
        "anyOf": [{"type": "integer", "maximum": 9}, {"type": "object"}],
        "description": "a whole number up to 9, or a mapping",
    },
}


BOMB = "a0: &a0 [1]\n" + "".join(f"a{n}: &a{n} [{','.join([f'*a{n - 1}'] * 10)}]\n" for n in range(1, 12))
"""Ten times more in each line."""


def _read(folder: Path, text: str) -> dict[str, Any]:
    (folder / "schema.json").write_text(json.dumps(SCHEMA))
    (folder / "own.yaml").write_text(text)
    return read_document(folder / "own.yaml", folder / "schema.json")


def test_keys_are_text_and_a_mapping_may_take_over_anothers(tmp_path: Path) -> None:
    text = "a: &a {x: 1, y: 2}\n1: {<<: *a, y: 3}\n"
    assert _read(tmp_path, text) == {"a": {"x": 1, "y": 2}, "1": {"x": 1, "y": 3}}


@pytest.mark.long
@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{1: 1, '1': 2}", "own.yaml: line 1: '1' is there twice: expected YAML, each key once"),
        ("{a: .nan}", "own.yaml: a: '.nan': expected a whole number up to 9, or a mapping"),
        ("{a: -.inf}", "own.yaml: a: '-.inf': expected a whole number up to 9, or a mapping"),
        ("{a: 1.5}", "own.yaml: a: 1.5: expected a whole number up to 9, or a mapping"),
        ("{a: true}", "own.yaml: a: True: expected a whole number up to 9, or a mapping"),
        ("&a {a: *a}", "own.yaml: nested too deep, or within itself: expected a readable YAML file"),
        (BOMB, "own.yaml: line 6: more than 100000 keys and values, with those that aliases repeat: expected YAML"),
        ("[" * 2000, "own.yaml: nested too deep, or within itself: "),
    ],
)
def test_a_mistake_is_one_line(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(UserError) as error:
        _read(tmp_path, text)
    assert str(error.value).removeprefix(f"{tmp_path}/").startswith(said)
    assert "\n" not in str(error.value)


def test_a_file_that_is_not_there_is_named_once(tmp_path: Path) -> None:
    with pytest.raises(UserError) as error:
        read_document(tmp_path / "none.yaml", tmp_path / "schema.json")
    assert str(error.value) == f"{tmp_path}/none.yaml: No such file or directory: expected a readable YAML file"
