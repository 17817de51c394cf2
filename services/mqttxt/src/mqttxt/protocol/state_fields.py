"""The fields of states: by names that stand alone, as tools that know nothing of states show them, and their ranges."""

from __future__ import annotations

from functools import cache

from ..errors import PayloadError
from .codec import layout_of
from .fields import Integer, Scaled
from .states import STATES, MavlinkState, State


def fields_of(state: str) -> dict[str, str]:
    """Of each field of a state the name that says both, where neither says the other: `battery_remaining_pct`."""
    names = [field.name for field in layout_of(STATES[state]).fields]
    return {name: state if name in state else name if name.startswith(state) else f"{state}_{name}" for name in names}


@cache
def _ranges(name: str) -> tuple[tuple[str, Integer | Scaled], ...]:
    layout = layout_of(STATES[name])
    return tuple((field.name, field.mark) for field in layout.fields if isinstance(field.mark, Integer | Scaled))


def check_range(state: State) -> None:
    """Raises PayloadError where a number of a state is outside the range that the state has."""
    if isinstance(state, MavlinkState):
        return
    for field, mark in _ranges(state.name):
        value = getattr(state, field)
        if value is not None and not mark.low <= value <= mark.high:
            raise PayloadError(f"{state.name}.{field}: expected {mark.low:g} to {mark.high:g}, got {value!r}")
