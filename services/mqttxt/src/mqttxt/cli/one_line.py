"""A user's mistake at any subcommand is one line that names the option, the value and the expectation."""

from __future__ import annotations

import re
import sys
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

_USAGE: Any = typer.BadParameter.__mro__[1]
"""The base class of typer's usage errors, which typer does not export."""
_VALUE = re.compile(r"'(.*?)' is not ", re.DOTALL)
_NOT_VALID = re.compile(r" valid (integer|number|float|boolean)")
_NOT_ONE_OF = re.compile(r" is not one of (.*)")
_KINDS = {"integer": "a whole number", "boolean": "true or false"}


class _OneLine:
    """Beside a command's class: a user's mistake ends the root command with one line and exit code 2."""

    name: str | None

    def main(self, *args: Any, **how: Any) -> Any:
        """As the base class does."""
        main: Any = super().main  # type: ignore[misc]
        if not how.get("standalone_mode", True):
            return main(*args, **how)
        how["standalone_mode"] = False
        try:
            code = main(*args, **how)
        except _USAGE as error:
            if type(error).__name__ == "NoArgsIsHelpError":
                error.show()
            else:
                typer.echo(f"{self.name}: {_line_of(error)}", err=True)
            code = error.exit_code
        except typer.Abort:
            typer.echo("Aborted!", err=True)
            code = 1
        sys.exit(code)


class OneLineErrors(_OneLine, TyperGroup):
    """The root command of a program with subcommands."""


class OneLineCommand(_OneLine, TyperCommand):
    """The only command of a program."""


def _line_of(error: Any) -> str:
    """The line for one of typer's errors."""
    where = _where(error.ctx)
    message = " ".join(error.format_message().split())
    parameter = getattr(error, "param", None)
    if "requires an argument" in message:
        return f"{where}{error.option_name}: expected a value behind it"
    if message.startswith("No such command") and "expected" not in message:
        message = f"{message.partition('. ')[0].removesuffix('.')}; expected {_commands(error.ctx)}"
    if parameter is None:
        return f"{where}{message[:1].lower()}{message[1:].removesuffix('.')}"
    name = max(parameter.opts, key=len) if parameter.param_type_name == "option" else parameter.name.upper()
    if hasattr(error, "param_type"):  # the parameter is missing
        return f"{where}expected {name}: {parameter.help}".rstrip(": ")
    said = " ".join(error.message.split())
    typed = f"{where}{name}{_value_of(error)}"
    if wrong := _NOT_VALID.search(said):
        return f"{typed}: expected {_KINDS.get(wrong[1], 'a number')}"
    if wrong := _NOT_ONE_OF.search(said):
        return f"{typed}: expected one of {wrong[1].replace(chr(39), '').removesuffix('.')}"
    return f"{typed}: {said.removesuffix('.')}"


def _commands(context: Any) -> str:
    """The visible commands, in the order of the help."""
    names = [name for name in context.command.list_commands(context) if not context.command.commands[name].hidden]
    return f"one of {', '.join(names)}" if len(names) > 1 else names[0]


def _where(context: Any) -> str:
    """The subcommand's words, without those of the program's own name."""
    words: list[str] = []
    while context is not None and context.parent is not None:
        words.insert(0, context.info_name)
        context = context.parent
    return f"{' '.join(words)}: " if words else ""


def _value_of(error: Any) -> str:
    """The typed value, if typer gives it: in its message, or in the cause of the error."""
    causes = error.__cause__.errors() if hasattr(error.__cause__, "errors") else []
    if causes:
        return f" {causes[0]['input']!r}"
    found = _VALUE.search(error.message)
    return f" {found[1]!r}" if found else ""
