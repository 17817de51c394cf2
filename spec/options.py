"""The options of each subcommand as Markdown tables, and the rules checked for each role as lists, for the pages.

`python -m spec.options FILE…` writes them between `<!-- generated: options … -->` and `<!-- end -->`.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import fields
from functools import partial
from typing import Any

import typer

from mqttxt.cli.main import app
from mqttxt.cli.station import DroneOptions, StationOptions
from mqttxt_conformance import activator, activator_air, activator_signed, gs, uav, uav_air
from mqttxt_conformance.registry import RULES, Rule

from .pages import pages
from .tables import filled, table

Row = tuple[str, str, str]
MANY = 3


def subcommands(parent: Any = None, path: str = "") -> dict[str, Any]:
    """Every subcommand, by its words joined as in `gs-watch`."""
    found: dict[str, Any] = {}
    root: Any = parent or typer.main.get_command(app)
    for name, command in sorted(root.commands.items()):
        whole = f"{path}{name}"
        found.update(subcommands(command, f"{whole}-") if hasattr(command, "commands") else {whole: command})
    return found


def groups(path: str) -> list[str]:
    """The groups that contain a subcommand: for `gs-plan-upload`, `gs` and `gs-plan`."""
    words = path.split("-")
    return ["-".join(words[:count]) for count in range(1, len(words))]


def group(name: str) -> str:
    """Every subcommand of a group under its own heading; above them the options that three or more share."""
    of_group = {
        path.removeprefix(f"{name}-"): command for path, command in subcommands().items() if path.startswith(f"{name}-")
    }
    takers: dict[Row | str, tuple[str, ...]] = {}
    for path, command in of_group.items():
        rows, shared = _parted(command)
        taken: list[Row | str] = [row for row in rows if row[0].startswith("`--")]
        for one in [*taken, *([shared] if shared else [])]:
            takers[one] = (*takers.get(one, ()), path)
    common = {one: those for one, those in takers.items() if len(those) >= MANY}
    parts = []
    for those in dict.fromkeys(common.values()):
        rows = [one for one, taking in common.items() if taking == those and isinstance(one, tuple)]
        links = [one for one, taking in common.items() if taking == those and isinstance(one, str)]
        who = "Each" if len(those) == len(of_group) else ", ".join(f"`{path}`" for path in those)
        takes = "takes" if who == "Each" else "take"
        parts += [f"{who} also {takes} {link}." for link in links]
        parts += [f"{who} also {takes}:", _table(rows)] if rows else []
    for path, command in of_group.items():
        rows, shared = _parted(command)
        own = [row for row in rows if row not in common]
        parts.append(f"### mqttxt {name.replace('-', ' ')} {path.replace('-', ' ')}")
        parts += [" ".join((command.help or "").split()), *([_table(own)] if own else [])]
        parts += [f"And {shared}."] if shared and shared not in common else []
    return "\n\n".join(parts)


def options(command: Any) -> str:
    """A subcommand's options; for widely shared ones, a link to them."""
    rows, shared = _parted(command)
    return "\n\n".join([*([_table(rows)] if rows else []), *([f"And {shared}."] if shared else [])])


def _parted(command: Any) -> tuple[list[Row], str]:
    """A subcommand's own rows, and links to those that it shares with others."""
    own, links = [_row(parameter) for parameter in command.params], []
    for shared, of in SHARED.items():
        if set(shared) <= {*own}:
            own = [row for row in own if row not in shared]
            links.append(f"[the options of {of}](ground-station.md#{_anchor(of)})")
    return own, " and ".join(links)


def _anchor(of: str) -> str:
    return f"options-of-{of.replace(' ', '-')}"


def _table(rows: Iterable[Row]) -> str:
    return table(("option", "what", "default"), rows)


def _rows_of(kind: type[Any], of: str) -> tuple[Row, ...]:
    """The rows of the options that are the fields of `kind`, as the subcommand `of` has them."""
    names = {field.name for field in fields(kind)}
    return tuple(_row(parameter) for parameter in subcommands()[of].params if parameter.name in names)


def rules_list(rules: list[Rule]) -> str:
    """A role's rules, grouped by the specification's section of their first number."""
    by_section: dict[int, list[str]] = {}
    for rule in rules:
        section = int(rule.numbers[0].removeprefix("R").partition(".")[0])
        by_section.setdefault(section, []).append(f"`{rule.name}` ({', '.join(rule.numbers)})")
    return "\n".join(f"- {', '.join(named)}" for _, named in sorted(by_section.items()))


def _row(parameter: Any) -> Row:
    is_option = parameter.param_type_name == "option"
    name = ", ".join(f"`{opt}`" for opt in parameter.opts) if is_option else f"`{parameter.name.upper()}`"
    help_text = parameter.help or ""
    if parameter.envvar:
        help_text += f" Also from the environment's `{parameter.envvar}`."
    if parameter.required:
        return name, help_text, "required"
    default = parameter.default
    return name, help_text, "" if default in (None, "", False) else f"`{default}`"


SHARED = {
    _rows_of(DroneOptions, "gs-plan-clear"): "one drone",
    _rows_of(StationOptions, "gs-watch"): "every station",
}
"""Rows that many subcommands share, and the name under which docs/ground-station.md lists them."""


def main(*files: str) -> None:
    """Write the tables into `files`."""
    found = subcommands()
    sections = {f"options-{name}": partial(options, command) for name, command in found.items()}
    sections |= {f"options-{name}": partial(group, name) for path in found for name in groups(path)}
    sections |= {_anchor(of): partial(_table, rows) for rows, of in SHARED.items()}
    rules = {"uav": uav.rules(), "activator": activator.rules(), "gs": gs.rules()}
    rules["two-links"] = RULES["uav with two connections"]
    rules["air-uav"] = RULES[uav_air.ROLE]
    rules["air-activator"] = RULES[activator_air.ROLE]
    rules["two-brokers"] = RULES["activator with two brokers"]
    rules["signed-activator"] = activator_signed.rules()
    sections |= {f"rules-{role}": partial(rules_list, checked) for role, checked in rules.items()}
    for path in pages(files):
        path.write_text(filled(path.read_text(encoding="utf-8"), sections), encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
