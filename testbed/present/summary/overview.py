"""All cells in order: experiments, within them profiles, within these every arm, flown or not."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from ...plan.experiments import ARMS
from ...plan.order import arms_in_order, experiments_in_order, profiles_in_order
from ...plan.profiles.reading import profile_names
from .cells import Cell
from .claims import JudgedClaim, claims
from .numbers import NumbersRow, not_flown, numbers_of, troubles


@dataclass(frozen=True)
class Block:
    """An experiment on a profile: a row for each arm, the judged claims of flown cells, and the failures."""

    profile: str
    rows: tuple[NumbersRow, ...]
    judged: tuple[tuple[Cell, tuple[JudgedClaim, ...]], ...]
    troubles: tuple[tuple[str, str], ...]
    """Arms, each with a line on failed or void attempts."""


@dataclass(frozen=True)
class Overview:
    """An experiment: a block for each profile on which it was flown, and the other profiles."""

    experiment: str
    blocks: tuple[Block, ...]
    missing: tuple[str, ...]

    def on(self, profile: str) -> Overview:
        """The part for one profile."""
        blocks = tuple(block for block in self.blocks if block.profile == profile)
        return Overview(self.experiment, blocks, () if blocks else (profile,))

    @property
    def cells(self) -> tuple[Cell, ...]:
        return tuple(row.cell for block in self.blocks for row in block.rows if row.cell is not None)


def overviews(cells: Iterable[Cell], experiments: Iterable[str] = ()) -> list[Overview]:
    """An overview for each experiment of the cells and of `experiments`, in order."""
    by_experiment: dict[str, list[Cell]] = {name: [] for name in experiments}
    for cell in cells:
        by_experiment.setdefault(cell.experiment, []).append(cell)
    return [_overview(name, by_experiment[name]) for name in experiments_in_order(by_experiment)]


def _overview(experiment: str, cells: list[Cell]) -> Overview:
    flown = profiles_in_order(cell.profile for cell in cells)
    blocks = [_block(profile, {cell.arm: cell for cell in cells if cell.profile == profile}) for profile in flown]
    missing = [name for name in profiles_in_order(profile_names()) if name not in flown]
    return Overview(experiment, tuple(blocks), tuple(missing))


def _block(profile: str, by_arm: dict[str, Cell]) -> Block:
    arms = arms_in_order([*ARMS, *by_arm])
    flown = [by_arm[arm] for arm in arms if arm in by_arm]
    return Block(
        profile=profile,
        rows=tuple(numbers_of(by_arm[arm]) if arm in by_arm else not_flown(arm) for arm in arms),
        judged=tuple((cell, tuple(claim.judge(cell) for claim in claims())) for cell in flown),
        troubles=tuple((cell.arm, said) for cell in flown for said in troubles(cell)),
    )
