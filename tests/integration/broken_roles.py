"""Starts a role of the project with one rule taken away: `python broken_roles.py VARIANT ROLE OPTIONS…`."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from mqttxt.messages import Word
from mqttxt.roles.executor import Executor
from mqttxt.roles.ledger import Admission, Ledger
from mqttxt.roles.uav_client import UavClient
from mqttxt.roles.uav_commands import CommandDesk

Patch = Callable[[], None]


def wrap(cls: Any, name: str, make: Callable[[Any], Any]) -> None:
    """Put `make(original)` in a method's place."""
    setattr(cls, name, make(getattr(cls, name)))


def uav_starts_late() -> None:
    def make(original: Any) -> Any:
        def on_command(self: Any, command: Any, retained: bool, now_ms: int) -> Any:
            if command.deadline_ms and command.deadline_ms < now_ms:
                command = replace(command, deadline_ms=now_ms + 3000)
            return original(self, command, retained, now_ms)

        return on_command

    wrap(CommandDesk, "_on_command", make)


def uav_takes_any_session() -> None:
    def make(original: Any) -> Any:
        def on_command(self: Any, command: Any, retained: bool, now_ms: int) -> Any:
            return original(self, replace(command, executor_session=self._session), retained, now_ms)

        return on_command

    wrap(CommandDesk, "_on_command", make)


def uav_executes_duplicates() -> None:
    def make(original: Any) -> Any:
        def examine(self: Any, command_id: Any, contents: Any, deadline_ms: int, now_ms: int) -> Any:
            verdict = original(self, command_id, contents, deadline_ms, now_ms)
            entry = self.get(command_id)
            if verdict is Admission.DUPLICATE and entry.record.words[-1].word is Word.COMPLETED:
                del self._entries[command_id]
                return Admission.NEW
            return verdict

        return examine

    wrap(Ledger, "examine", make)


def uav_repeats_late() -> None:
    def make(original: Any) -> Any:
        def send(self: Any, run: Any, now_ms: int) -> Any:
            run.deadline_ms += 60_000
            return original(self, run, now_ms)

        return send

    wrap(Executor, "_send", make)


def uav_forgets_the_order() -> None:
    def make(original: Any) -> Any:
        def refusal(self: Any, *arguments: Any) -> Any:
            self._highest_started.clear()
            return original(self, *arguments)

        return refusal

    wrap(CommandDesk, "_refusal", make)


def uav_takes_retained() -> None:
    def make(original: Any) -> Any:
        return lambda self, command, retained, now_ms: original(self, command, False, now_ms)

    wrap(CommandDesk, "_on_command", make)


def uav_is_always_a_ground_station() -> None:
    wrap(UavClient, "is_controlled", lambda original: lambda self, now_ms: True)


VARIANTS: dict[str, Patch] = {
    "uav-starts-late": uav_starts_late,
    "uav-takes-any-session": uav_takes_any_session,
    "uav-executes-duplicates": uav_executes_duplicates,
    "uav-repeats-late": uav_repeats_late,
    "uav-forgets-the-order": uav_forgets_the_order,
    "uav-takes-retained": uav_takes_retained,
    "uav-is-always-a-ground-station": uav_is_always_a_ground_station,
}

if __name__ == "__main__":
    from mqttxt.cli import main

    VARIANTS[sys.argv.pop(1)]()
    main()
