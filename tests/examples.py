"""How many examples a test tries: in `make check` a tenth of them, and of several histories the first."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest
from hypothesis import settings


def examples(count: int, **more: Any) -> settings:
    """Settings with `count` examples for a property; in the profile of `make check` a tenth of them, at least five."""
    is_quick = settings.get_current_profile_name() == "quick"
    return settings(max_examples=max(5, count // 10) if is_quick else count, **more)


def first_quick(values: Iterable[Any], quick: int = 1) -> list[Any]:
    """A test's parameters, of which those after the first `quick` are marked `long`."""
    return [pytest.param(one, marks=[pytest.mark.long] if i >= quick else []) for i, one in enumerate(values)]
