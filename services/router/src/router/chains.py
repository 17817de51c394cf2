"""The routers of a node: mavp2p's arguments, one line per router, from the environment that compose.yaml sets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

CHAINS = ("per-uav", "shared", "direct")
_VARIABLES = {"per-uav": "PER_UAV", "shared": "SHARED"}


class ChainError(Exception):
    """A chain that cannot be run; the text names the option or variable, its value and the expected one."""


@dataclass(frozen=True)
class Router:
    """One mavp2p: its arguments, and the system ids of the autopilots that it must hear for the node to be ready."""

    arguments: tuple[str, ...]
    drones: tuple[int, ...]

    @property
    def name(self) -> str:
        return f"uav{self.drones[0]}" if len(self.drones) == 1 else "all"


def parse_drones(text: str) -> tuple[int, ...]:
    """System ids from `1,2,3`; raises ChainError for other text."""
    parts = [part.strip() for part in text.split(",")]
    if not all(part.isascii() and part.isdecimal() and 1 <= int(part) <= 250 for part in parts):
        raise ChainError(f"--drones {text!r}: expected system ids from 1 to 250, as 1,2,3")
    return tuple(int(part) for part in parts)


def read_chain(
    chain: str, drones: tuple[int, ...], environment: Mapping[str, str], only: tuple[int, ...] | None = None
) -> tuple[Router, ...]:
    """A node's routers: one for each drone in `per-uav`, one for all in `shared`, none in `direct`.

    `only` are the drones that fly, if not all do: a router waits for these alone, and one without any is left out.
    Raises ChainError for an unknown chain, or a variable that is missing or has not one line per router.
    """
    if chain not in CHAINS:
        raise ChainError(f"--chain {chain!r}: expected one of {', '.join(CHAINS)}")
    if chain == "direct":
        return ()
    variable = _VARIABLES[chain]
    lines = [line.split() for line in environment.get(variable, "").splitlines() if line.strip()]
    heard = [(drone,) for drone in drones] if chain == "per-uav" else [drones]
    if len(lines) != len(heard):
        raise ChainError(f"{variable}: {len(lines)} lines, expected {len(heard)}: mavp2p's arguments, a router a line")
    flying = drones if only is None else only
    routers = (
        Router(tuple(line), tuple(drone for drone in ids if drone in flying))
        for line, ids in zip(lines, heard, strict=True)
    )
    return tuple(router for router in routers if router.drones)
