"""Checks the file of a user's own mission before anything is started for it."""

from __future__ import annotations

import ast
from pathlib import Path

from ..errors import UserError

EXPECTED = "expected a Python file with `async def mission(fleet, steps)`"
_NAME, _PARAMETERS = "mission", 2


def check_mission(path: Path) -> None:
    """Check the file without running it. Raises UserError that names it, and the line of a mistake in it."""
    try:
        tree = ast.parse(path.read_bytes(), str(path))
    except OSError as error:
        raise UserError(f"{path}: {EXPECTED}: {error.strerror}") from error
    except SyntaxError as error:
        line = f", line {error.lineno}" if error.lineno else ""
        raise UserError(f"{path}{line}: {error.msg}") from error
    except (ValueError, RecursionError, MemoryError) as error:  # the last two: nested too deep for Python
        raise UserError(f"{path}: {EXPECTED}: {str(error) or 'nested too deep'}") from error
    found = [one for one in tree.body if isinstance(one, ast.AsyncFunctionDef) and one.name == _NAME]
    if not found:
        raise UserError(f"{path}: {EXPECTED}")
    taken = found[-1].args
    if len(taken.posonlyargs) + len(taken.args) != _PARAMETERS or None in taken.kw_defaults:
        raise UserError(f"{path}, line {found[-1].lineno}: {EXPECTED}")
