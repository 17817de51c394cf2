"""The fields of states by names that stand alone, as tools that know nothing of states show them."""

from __future__ import annotations

from .codec import layout_of
from .states import STATES


def fields_of(state: str) -> dict[str, str]:
    """Of each field of a state the name that says both, where neither says the other: `battery_remaining_pct`."""
    names = [field.name for field in layout_of(STATES[state]).fields]
    return {name: state if name in state else name if name.startswith(state) else f"{state}_{name}" for name in names}
