"""The order in which experiments, arms and profiles are flown and shown: the most wanted ones first."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from .experiments import ARMS, EXPERIMENTS

FIRST_PROFILES = ("ideal", "thesis", "lte", "lossy")


def experiments_in_order(names: Iterable[str]) -> list[str]:
    """The project's experiments as listed in EXPERIMENTS, then users' own missions."""
    return _sorted(names, tuple(EXPERIMENTS))


def arms_in_order(names: Iterable[str]) -> list[str]:
    """Arms in the order of ARMS; an arm with deviating factors (`thesis+qos-1`) follows the arm."""
    return _sorted(names, tuple(ARMS), lambda name: name.partition("+")[0])


def profiles_in_order(names: Iterable[str]) -> list[str]:
    """`FIRST_PROFILES`, then the others by name."""
    return _sorted(names, FIRST_PROFILES)


def _sorted(names: Iterable[str], known: tuple[str, ...], base: Callable[[str], str] = str) -> list[str]:
    def place(name: str) -> tuple[int, str]:
        return (known.index(base(name)) if base(name) in known else len(known), name)

    return sorted(set(names), key=place)
