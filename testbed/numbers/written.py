"""`metrics.json` as it is written, around its attempts: the names and types of its schema (docs/results-folder.md)."""

from typing import NotRequired, TypedDict

from .attempt_entry import AttemptEntry, LossEntry


class VoidEntry(TypedDict):
    """An attempt that does not count."""

    attempt: int
    repeat: NotRequired[int]
    reason: str
    load: NotRequired[float]


class SideEntry(TypedDict):
    """One protocol's attempts."""

    attempts: list[AttemptEntry]
    void: list[VoidEntry]


class CompletionEntry(TypedDict):
    """The number of attempts by how they ended."""

    flown: int
    completed: int
    failed: int
    void: int


class SpreadEntry(TypedDict):
    """A quantity over a side's attempts; `points` are its values by attempt number."""

    n: int
    mean: float | None
    median: float | None
    interval: list[float] | None
    points: dict[str, float]


class PairedTestEntry(TypedDict):
    """The paired permutation test of both sides."""

    pairs: int
    difference: float
    p: float
    effect: float


class Statistics(TypedDict):
    """The attempts taken together; each of `metrics` has a spread per protocol, and a `test`."""

    completion: dict[str, CompletionEntry]
    metrics: dict[str, dict[str, SpreadEntry | PairedTestEntry | None]]
    losses: dict[str, dict[str, LossEntry]]


class Metrics(TypedDict):
    """The whole document."""

    version: int
    experiment: str
    arm: str
    profile: str
    revision: str | None
    machine: NotRequired[str | None]
    shaper: str
    protocols: dict[str, SideEntry]
    ratios: dict[str, float]
    statistics: Statistics
    notes: list[str]
