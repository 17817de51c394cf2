"""A mission of one's own: a Python file with `async def mission(fleet, steps)`."""

from __future__ import annotations

import inspect
import traceback
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

from .fleet import Fleet, MissionError
from .scenarios import SCENARIOS
from .steps import Steps

Mission = Callable[[Fleet, Steps], Awaitable[None]]
NAME = "mission"
SUFFIX = ".py"


def mission_of(name: str) -> Mission:
    """A scenario by its name, or what a file has; raises ValueError for a file that has no mission."""
    return load(Path(name)) if name.endswith(SUFFIX) else SCENARIOS[name]


def load(path: Path) -> Mission:
    """The mission of a file, which is run for it. What the file raises, then or in flight, is named with its line."""
    own: dict[str, Any] = {"__name__": path.stem, "__file__": str(path)}
    try:
        exec(compile(path.read_text(encoding="utf-8"), str(path), "exec"), own)
    except OSError as error:
        raise ValueError(f"{path}: {error.strerror}") from error
    except SyntaxError as error:
        raise ValueError(f"{path}, line {error.lineno}: {error.msg}") from error
    except Exception as error:
        raise ValueError(_said(path, error)) from error
    found = own.get(NAME)
    if not inspect.iscoroutinefunction(found) or len(inspect.signature(found).parameters) != 2:
        raise ValueError(f"{path}: expected `async def {NAME}(fleet, steps)`")

    async def fly(fleet: Fleet, steps: Steps) -> None:
        try:
            await found(fleet, steps)
        except MissionError:
            raise
        except Exception as error:
            raise MissionError(_said(path, error)) from error

    return fly


def _said(path: Path, error: Exception) -> str:
    """What was raised, and the last line of the file that led there."""
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
    return f"{path}, line {lines[-1] if lines else '?'}: {type(error).__name__}: {' '.join(str(error).split())}"
