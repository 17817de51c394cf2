"""The options of each subcommand, and the rules that are checked of each role, as Markdown tables for the pages.

`python -m spec.options FILE…` writes them between `<!-- generated: options … -->` and `<!-- end -->`.
"""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import Any

import typer

from mqttxt.cli.main import app
from mqttxt_conformance import activator, activator_signed, gs, uav
from mqttxt_conformance.registry import RULES, Rule

from .tables import filled, table


def subcommands(parent: Any = None, path: str = "") -> dict[str, Any]:
    """Every subcommand by its words, as `gs-watch`."""
    found: dict[str, Any] = {}
    root: Any = parent or typer.main.get_command(app)
    for name, command in sorted(root.commands.items()):
        whole = f"{path}{name}"
        found.update(subcommands(command, f"{whole}-") if hasattr(command, "commands") else {whole: command})
    return found


def groups(path: str) -> list[str]:
    """The groups that a subcommand is in: `gs` and `gs-plan` of `gs-plan-upload`."""
    words = path.split("-")
    return ["-".join(words[:count]) for count in range(1, len(words))]


def group(name: str) -> str:
    """Every subcommand of a group under its own heading, with what it says of itself."""
    parts = [
        f"### mqttxt {path.replace('-', ' ')}\n\n{' '.join((command.help or '').split())}\n\n{options(command)}"
        for path, command in subcommands().items()
        if path.startswith(f"{name}-")
    ]
    return "\n\n".join(parts)


def options(command: Any) -> str:
    """What a subcommand takes."""
    return table(("option", "what", "default"), [_row(parameter) for parameter in command.params])


def rules_table(rules: list[Rule]) -> str:
    """A role's rules as a Markdown table."""
    rows = [(f"`{rule.name}`", ", ".join(rule.numbers), rule.statement) for rule in rules]
    return table(("rule", "specification", "what is checked"), rows)


def _row(parameter: Any) -> tuple[str, str, str]:
    is_option = parameter.param_type_name == "option"
    name = ", ".join(f"`{opt}`" for opt in parameter.opts) if is_option else f"`{parameter.name.upper()}`"
    help_text = parameter.help or ""
    if parameter.envvar:
        help_text += f" Also from the environment's `{parameter.envvar}`."
    if parameter.required:
        return name, help_text, "required"
    default = parameter.default
    return name, help_text, "" if default in (None, "", False) else f"`{default}`"


def main(*files: str) -> None:
    """Write the tables into `files`."""
    found = subcommands()
    sections = {f"options-{name}": partial(options, command) for name, command in found.items()}
    sections |= {f"options-{name}": partial(group, name) for path in found for name in groups(path)}
    rules = {"uav": uav.rules(), "activator": activator.rules(), "gs": gs.rules()}
    rules["two-links"] = RULES["uav with two connections"]
    rules["two-brokers"] = RULES["activator with two brokers"]
    rules["signed-activator"] = activator_signed.rules()
    sections |= {f"rules-{role}": partial(rules_table, checked) for role, checked in rules.items()}
    for path in map(Path, files):
        path.write_text(filled(path.read_text(encoding="utf-8"), sections), encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
