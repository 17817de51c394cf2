"""A user's own mission: a Python file with `async def mission(fleet, steps)`."""

from __future__ import annotations

import inspect
import sys
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
    """The scenario of that name, or the mission in a file. Raises ValueError for a file without a mission."""
    return load(Path(name)) if name.endswith(SUFFIX) else SCENARIOS[name]


def load(path: Path) -> Mission:
    """Run a file and return its mission. Raises ValueError if it has none or raises.

    Its errors, now or in flight, are named with their line; their tracebacks go to stderr.
    """
    own: dict[str, Any] = {"__name__": path.stem, "__file__": str(path)}
    try:
        code = compile(path.read_bytes(), str(path), "exec", dont_inherit=True)
    except OSError as error:
        raise ValueError(f"{path}: {error.strerror}") from error
    except SyntaxError as error:
        raise ValueError(f"{path.name}, line {error.lineno}: {error.msg}") from error
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}") from error
    try:
        exec(code, own)
    except (Exception, SystemExit) as error:
        raise ValueError(_said(path, error)) from error
    found = own.get(NAME)
    if not inspect.iscoroutinefunction(found) or len(inspect.signature(found).parameters) != 2:
        raise ValueError(f"{path.name}: expected `async def {NAME}(fleet, steps)`")

    async def fly(fleet: Fleet, steps: Steps) -> None:
        try:
            await found(fleet, steps)
        except MissionError:
            raise
        except (Exception, SystemExit) as error:
            raise MissionError(_said(path, error)) from error

    return fly


def _said(path: Path, error: BaseException) -> str:
    """Describe an error by its text and the last line of the file in its traceback, which is printed on stderr.

    Of an exception group the first error is described.
    """
    traceback.print_exception(error, file=sys.stderr)
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    if isinstance(error, MissionError):
        return str(error)
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
    text = " ".join(str(error).split())
    where = f"{path.name}, line {lines[-1] if lines else '?'}"
    return f"{where}: {type(error).__name__}: {text}" if text else f"{where}: {type(error).__name__}"
