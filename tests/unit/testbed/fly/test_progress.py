"""The progress of a run on a terminal."""

from __future__ import annotations

from io import StringIO

from rich.console import Console

from testbed.fly.progress import ConsoleProgress


def test_a_step_of_an_own_mission_may_have_any_name() -> None:
    console = Console(file=StringIO(), force_terminal=True, width=100)
    progress = ConsoleProgress(console)
    progress.step("[/look]", {"1": "[/armed]"}, 1.0)
    progress.ended("completed", None)
    assert isinstance(console.file, StringIO)
    assert "[/look]" in console.file.getvalue()
    assert "1 [/armed]" in console.file.getvalue()
