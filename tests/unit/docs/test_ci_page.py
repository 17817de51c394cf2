"""The page about continuous integration: its workflows are YAML, and what they run is there."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import yaml

from testbed.fly.results import METRICS, REPORT
from testbed.numbers.metrics import verdict

ROOT = Path(__file__).resolve().parents[3]
PAGE = (ROOT / "docs" / "ci.md").read_text()
WORKFLOWS = [yaml.safe_load(block) for block in re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)]
TARGETS = set(re.findall(r"^([a-z0-9-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))


def _scripts() -> list[str]:
    """Every command of the page."""
    github, gitlab = WORKFLOWS
    steps = [step["run"] for step in github["jobs"]["scenario-1"]["steps"] if "run" in step]
    shell = [line for block in re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL) for line in block.splitlines()]
    return [*steps, *gitlab["scenario-1"]["script"], *shell, *re.findall(r"^\| `([^`]*)`", PAGE, re.MULTILINE)]


def test_what_the_workflows_make_are_targets() -> None:
    made = [shlex.split(script)[1] for script in _scripts() if script.startswith("make ")]
    assert set(made) == {"scenario-1", "check", "test", "soak", "links", "all"}
    assert set(made) <= TARGETS


def test_the_variables_are_those_of_the_Makefile() -> None:
    variables = {word.partition("=")[0] for script in _scripts() for word in shlex.split(script)[2:] if "=" in word}
    typed = {name for name in variables if name.isupper()}
    assert typed == {"PROFILE", "PROTOCOLS", "SCHEDULER"}
    assert all(re.search(rf"^{name} \?=", (ROOT / "Makefile").read_text(), re.MULTILINE) for name in typed)


def test_every_requirement_is_one_and_both_services_have_the_same() -> None:
    required = [
        [words[place + 1] for place, word in enumerate(words) if word == "--require"]
        for words in (shlex.split(script) for script in _scripts() if "verdict" in script)
    ]
    assert [len(one) for one in required] == [3, 3, 3]
    assert required[0] == required[1] == required[2]
    assert [str(verdict.parse(text)) for text in required[0]]


@pytest.mark.parametrize("kept", [METRICS, REPORT, "figures"])
def test_report_and_numbers_are_kept_whatever_happened(kept: str) -> None:
    github, gitlab = WORKFLOWS
    upload: dict[str, Any] = next(step for step in github["jobs"]["scenario-1"]["steps"] if "upload" in str(step))
    assert upload["if"] == "always()"
    assert f"latest/{kept}" in upload["with"]["path"]
    artifacts = gitlab["scenario-1"]["artifacts"]
    assert artifacts["when"] == "always"
    assert any(path.rstrip("/").endswith(f"/{kept}") for path in artifacts["paths"])
