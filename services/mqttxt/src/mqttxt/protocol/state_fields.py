"""The fields of states: names that are clear without the state, for tools that list fields alone, and ranges."""

from __future__ import annotations

from functools import cache

from ..errors import PayloadError
from .codec import layout_of
from .fields import Integer, Scaled
from .states import STATES, MavlinkState, State


def fields_of(state: str) -> dict[str, str]:
    """The full name of each field of a state: both names, as `battery_remaining_pct`, unless one implies the other."""
    names = [field.name for field in layout_of(STATES[state]).fields]
    return {name: state if name in state else name if name.startswith(state) else f"{state}_{name}" for name in names}


@cache
def _ranges(name: str) -> tuple[tuple[str, Integer | Scaled], ...]:
    layout = layout_of(STATES[name])
    return tuple((field.name, field.mark) for field in layout.fields if isinstance(field.mark, Integer | Scaled))


def check_range(state: State) -> None:
    """Raises PayloadError if a number of a state is outside its field's range. MavlinkStates are not checked."""
    if isinstance(state, MavlinkState):
        return
    for field, mark in _ranges(state.name):
        value = getattr(state, field)
        if value is not None and not mark.low <= value <= mark.high:
            raise PayloadError(f"{state.name}.{field}: expected {mark.low:g} to {mark.high:g}, got {value!r}")
