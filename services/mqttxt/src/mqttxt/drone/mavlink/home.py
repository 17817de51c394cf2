"""The home of an arming, above which every height is published and flown (docs/protocol.md, R3.10)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Self

from ...protocol.policies import is_elsewhere
from ...protocol.states import Home, Location, State


class HomeOfArming:
    """Holds home's altitude while a drone is armed, unless home is moved to another place.

    PX4 corrects that altitude in flight, by a metre and several times per second: `relative_alt` of
    GLOBAL_POSITION_INT jumps with it, though the drone does not.
    """

    def __init__(self) -> None:
        self._altitude_m: float | None = None
        self._home: Home | None = None

    def __copy__(self) -> Self:
        twin = type(self)()
        twin._altitude_m, twin._home = self._altitude_m, self._home
        return twin

    def correct(self, told: Iterable[State], is_armed: bool) -> list[State]:
        """A message's states, with heights above this home, and with home itself if it has changed."""
        if not is_armed:
            self._altitude_m = None
        out: list[State] = []
        for state in told:
            if isinstance(state, Home):
                if self._altitude_m is not None:
                    if self._home is not None and is_elsewhere(self._home, state):
                        self._altitude_m = state.altitude_amsl_m
                    state = replace(state, altitude_amsl_m=self._altitude_m)
                self._home = state
            elif is_armed and isinstance(state, Location):
                if self._altitude_m is None:  # at 4 Hz and more, fresher than HOME_POSITION, which arrives every 2 s
                    self._altitude_m = _difference_m(state.altitude_amsl_m, state.altitude_m)
                    if self._home is not None:
                        self._home = replace(self._home, altitude_amsl_m=self._altitude_m)
                        out.append(self._home)
                state = replace(state, altitude_m=_difference_m(state.altitude_amsl_m, self._altitude_m))
            out.append(state)
        return out


def _difference_m(one_m: float, other_m: float) -> float:
    """In whole millimetres, as in MAVLink."""
    return round(one_m - other_m, 3)
