"""Requirements on a series' metrics, for CI: `ratios.packets>=50`, `mqttxt.delay_ms.arm<=20`."""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from statistics import mean, median
from typing import Any

from ...errors import UserError
from ..quantities import RATIOS

OPERATORS: dict[str, Callable[[float, float], bool]] = {
    ">=": operator.ge,
    "<=": operator.le,
    "==": operator.eq,
    "!=": operator.ne,
    ">": operator.gt,
    "<": operator.lt,
}
OVER_ATTEMPTS: dict[str, Callable[[list[float]], float]] = {"median": median, "mean": mean, "min": min, "max": max}
COUNTS = ("flown", "completed", "failed", "void")
_FORM = re.compile(
    rf"\s*([^<>=!]+?)\s*({'|'.join(map(re.escape, OPERATORS))})\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?)(\s*%)?\s*",
    re.IGNORECASE,
)
_SHOWN = 12


@dataclass(frozen=True)
class Requirement:
    """A condition on a number in `metrics.json`; `text` is the requirement as the user wrote it."""

    text: str
    path: tuple[str, ...]
    operator: str
    limit: float


@dataclass(frozen=True)
class Answer:
    """The value at a requirement's path; None where nothing was measured, which never meets the requirement."""

    requirement: Requirement
    value: float | None

    @property
    def met(self) -> bool:
        wanted = self.requirement
        return self.value is not None and OPERATORS[wanted.operator](self.value, wanted.limit)

    def __str__(self) -> str:
        said = "nothing was measured" if self.value is None else f"{self.value:.9g}"
        return f"{'met' if self.met else 'not met'}: {self.requirement.text}: {said}"


def parse(text: str) -> Requirement:
    """Parse PATH OPERATOR NUMBER, where a `%` may follow the number. Raises UserError for any other text."""
    found = _FORM.fullmatch(text)
    if found is None:
        raise UserError(
            f"--require {text!r}: expected PATH, one of {' '.join(OPERATORS)}, and a number, as ratios.packets>=50"
        )
    path, sign, number, per_cent = found.groups()
    limit = float(number) / (100 if per_cent else 1)
    if not math.isfinite(limit):
        raise UserError(f"--require {text!r}: {number} is too large a number")
    return Requirement(text.strip(), tuple(path.split(".")), sign, limit)


def judge(metrics: Mapping[str, Any], requirement: Requirement) -> Answer:
    """Look up a requirement's value in a series' metrics. Raises UserError if its path leads to no number."""
    first, *rest = requirement.path
    if first in metrics["protocols"]:
        return Answer(requirement, _over_attempts(metrics["protocols"][first], first, rest, requirement))
    if first not in metrics:
        known = [*metrics["protocols"], *(name for name, value in metrics.items() if isinstance(value, dict))]
        raise _nowhere(requirement, "", first, known)
    if first == "ratios" and not metrics["ratios"] and rest and rest[0] in RATIOS:
        return Answer(requirement, None)  # one side has no completed attempt
    values = _numbers(metrics, list(requirement.path), requirement)
    if values is not None and len(values) > 1:
        raise UserError(f"--require {requirement.text!r}: {'.'.join(requirement.path)} is a list, expected a number")
    return Answer(requirement, values[0] if values else None)


def _over_attempts(side: Mapping[str, Any], protocol: str, path: list[str], requirement: Requirement) -> float | None:
    """A count of a protocol's attempts, or a number over the completed ones: the median, unless `path` names another
    of OVER_ATTEMPTS."""
    attempts = side["attempts"]
    done = [attempt for attempt in attempts if attempt["status"] == "completed"]
    if len(path) == 1 and path[0] in COUNTS:
        counts = {"flown": len(attempts), "completed": len(done), "void": len(side["void"])}
        return float({**counts, "failed": len(attempts) - len(done)}[path[0]])
    name, inner = (path[0], path[1:]) if path and path[0] in OVER_ATTEMPTS else ("median", path)
    if not inner:
        known = [*COUNTS, *OVER_ATTEMPTS, *(done[0] if done else ())]
        raise _nowhere(requirement, protocol, "", known)
    if not done:
        return None
    values: list[float] = []
    missing: UserError | None = None
    for attempt in done:
        try:
            values += _numbers(attempt, inner, requirement, protocol) or []
        except _Missing as error:
            missing = error
    if missing is not None and not values:
        raise missing
    return float(OVER_ATTEMPTS[name](values)) if values else None


class _Missing(UserError):
    """A path that leads nowhere."""


def _numbers(tree: Any, path: list[str], requirement: Requirement, below: str = "") -> list[float] | None:
    """The number at a path, or all numbers of a list, without the nulls of lost messages; None where nothing was
    measured."""
    so_far = [below] if below else []
    for name in path:
        if tree is None:
            return None
        if isinstance(tree, list) and name.isascii() and name.isdecimal() and int(name) < len(tree):
            tree = tree[int(name)]
        elif isinstance(tree, dict) and name in tree:
            tree = tree[name]
        else:
            known = list(tree) if isinstance(tree, dict) else _places(tree)
            raise _nowhere(requirement, ".".join(so_far), name, known)
        so_far.append(name)
    if tree is None:
        return None
    values = [value for value in tree if value is not None] if isinstance(tree, list) else [tree]
    if any(isinstance(value, bool) or not isinstance(value, int | float) for value in values):
        known = list(tree) if isinstance(tree, dict) else _places(tree)
        raise _nowhere(requirement, ".".join(so_far), "", known)
    return [float(value) for value in values]


def _places(tree: Any) -> list[str]:
    return [str(number) for number in range(len(tree))] if isinstance(tree, list) else []


def _nowhere(requirement: Requirement, below: str, name: str, known: list[str]) -> _Missing:
    where = f"in {below}" if below else "in metrics.json"
    what = f"there is no {name} {where}" if name else f"{below} is no number"
    shown = ", ".join(sorted(known)[:_SHOWN]) + (", …" if len(known) > _SHOWN else "")
    return _Missing(f"--require {requirement.text!r}: {what}" + (f"; there is {shown}" if known else ""))
