"""What a quantity is: how a side's figure is made from its attempts, and how it is written.

A figure is the median of the completed attempts; a share is taken over all of them together. A median comes with the
mean and, from six attempts on, the mean's 95 % bootstrap interval, both from the same points.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from statistics import mean, median

from . import words
from .observed import NOTHING_SENT, Loss, ObservedAttempt, Side
from .statistics import interval

ABOVE, BELOW = "mavlink", "mqttxt"
"""A ratio is the figure of ABOVE over the figure of BELOW."""


@dataclass(frozen=True)
class QuantityFigure:
    """A quantity of one side: its text, its value, and each attempt's value by number; `loss` if it is a share."""

    text: str
    value: float | None = None
    by_attempt: Mapping[int, float] = field(default_factory=dict)
    write: Callable[[float | None], str] = words.digits
    loss: Loss | None = None

    @classmethod
    def of_loss(cls, loss: Loss, by_attempt: Mapping[int, float] | None = None) -> QuantityFigure:
        """A share of all that was sent: percent and number sent; where nothing was lost, the 95 % bound."""
        return cls(words.loss(loss.share, loss.known), loss.share, by_attempt or {}, words.share, loss)

    @property
    def points(self) -> tuple[float, ...]:
        return tuple(self.by_attempt.values())

    @property
    def mean(self) -> float | None:
        return mean(self.points) if self.by_attempt else None

    @cached_property
    def interval(self) -> tuple[float, float] | None:
        """The 95 % interval of the mean; None below six attempts."""
        return interval(self.points)

    @property
    def brief(self) -> str:
        """A share in little room: '23 %'; if nothing was lost '0 (< 0.44 %)', if nothing of very few '0 of 2'."""
        if self.loss is None or self.loss.share is None:
            return self.text
        if self.loss.lost:
            return words.share(self.loss.share)
        return f"0 of {self.loss.known}" if self.loss.below == 1.0 else f"0 (< {words.share(self.loss.below)})"

    @property
    def counts(self) -> str:
        """A share as two counts: '191 of 10,182'."""
        known = self.loss.known if self.loss is not None else 0
        return f"{self.loss.lost:,} of {known:,}" if self.loss is not None and known else words.NOTHING

    @property
    def more(self) -> str:
        """The mean of several attempts: 'mean 36.5 s', and from six on 'mean 36.5 s (36.1 s to …)'."""
        if self.loss is not None or len(self.points) < 2:
            return ""
        bounds = f" ({' to '.join(map(self.write, self.interval))})" if self.interval else ""
        return f"mean {self.write(self.mean)}{bounds}"


@dataclass(frozen=True)
class Quantity:
    """A number of each attempt: `key` is its name in `metrics.json`, `name` that in tables.

    A side's figure is the median of its completed attempts, or with `counted` of all that count, failed ones too.
    """

    key: str
    name: str
    unit: str
    write: Callable[[float | None], str]
    of: Callable[[ObservedAttempt], float | None]
    counted: bool = False

    def figure(self, side: Side) -> QuantityFigure:
        points = self.points(side)
        middle = median(points.values()) if points else None
        return QuantityFigure(self.write(middle), middle, points, self.write)

    def points(self, side: Side) -> dict[int, float]:
        """The values by attempt number. A failed attempt is censored, that is has no value, except with `counted`."""
        attempts = side.attempts if self.counted else side.completed
        found = ((attempt.number, self.of(attempt)) for attempt in attempts)
        return {number: float(value) for number, value in found if value is not None}

    def ratio(self, figures: Mapping[str, QuantityFigure]) -> float | None:
        """MAVLink's figure over MQTT-XT's; None where one is missing or the divisor is zero."""
        if not {ABOVE, BELOW} <= set(figures):
            return None
        return quotient(figures[ABOVE].value, figures[BELOW].value)


@dataclass(frozen=True)
class Share(Quantity):
    """The share lost: the sum of `count` over all attempts. It has no ratio."""

    count: Callable[[ObservedAttempt], Loss] = lambda _: NOTHING_SENT

    def figure(self, side: Side) -> QuantityFigure:
        return self.together(side.attempts if self.counted else side.completed)

    def together(self, attempts: Sequence[ObservedAttempt]) -> QuantityFigure:
        """The share over these attempts, completed or not."""
        loss = sum((self.count(attempt) for attempt in attempts), NOTHING_SENT)
        points = {attempt.number: share for attempt in attempts if (share := self.count(attempt).share) is not None}
        return QuantityFigure.of_loss(loss, points)

    def ratio(self, figures: Mapping[str, QuantityFigure]) -> float | None:
        return None


@dataclass(frozen=True)
class Completed(Quantity):
    """How many of the attempts that count were completed, and how many are void."""

    def figure(self, side: Side) -> QuantityFigure:
        voids = f" ({side.void} void)" if side.void else ""
        return QuantityFigure(f"{len(side.completed)} of {len(side.attempts)}{voids}", float(len(side.completed)))

    def ratio(self, figures: Mapping[str, QuantityFigure]) -> float | None:
        return None


@dataclass(frozen=True)
class ByCommand(Quantity):
    """A number of each command. The figure is the least and the greatest of the commands' means over attempts."""

    values: Callable[[ObservedAttempt], Mapping[str, float]] = lambda _: {}

    def figure(self, side: Side) -> QuantityFigure:
        found: dict[str, list[float]] = {}
        for attempt in side.completed:
            for command, value in self.values(attempt).items():
                found.setdefault(command, []).append(value)
        means = sorted(sum(values) / len(values) for values in found.values())
        if not means:
            return QuantityFigure(words.NOTHING)
        least, most = self.write(means[0]), self.write(means[-1])
        return QuantityFigure(least if least == most else f"{least} to {most}")

    def ratio(self, figures: Mapping[str, QuantityFigure]) -> float | None:
        return None


def quotient(above: float | None, below: float | None) -> float | None:
    """`above` / `below`; None where one is missing or the divisor is zero."""
    return above / below if above is not None and below else None
