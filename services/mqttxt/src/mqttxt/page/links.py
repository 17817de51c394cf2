"""Links that a page also shows and changes, where whoever serves it has some, as a testbed has."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True)
class LinkFigures:
    """How one direction of a link is now.

    Parameters:
        name: of link and direction, as `air:uav3:up`.
        packets_per_s: what went into it lately, in frames per second.
        bytes_per_s: the same in bytes per second.
        rate_bps: bits per second, None where it is unlimited.
        delay_ms: milliseconds, one way.
        loss: the share of frames that is lost, 0 to 1.
        is_closed: nothing passes.
        is_changed: the figures are not those that were planned.
    """

    name: str
    packets_per_s: float
    bytes_per_s: float
    rate_bps: int | None
    delay_ms: float
    loss: float
    is_closed: bool
    is_changed: bool


class Links(Protocol):
    """What a page asks of its links. They are called in a thread, one after the other."""

    @property
    def title(self) -> str:
        """What they carry, as `MQTT-XT`."""

    def look(self) -> list[LinkFigures]:
        """Every direction of every link; raises nothing."""

    def change(self, name: str, figures: Mapping[str, str], closed: bool) -> None:
        """Change a link, both directions alike; what is not named stays as it is.

        Parameters:
            name: of the link, as `air:uav3`.
            figures: of `rate`, `delay` and `loss`, with their units, as `64kbit`, `200ms` and `20%`.
            closed: whether nothing passes.

        Raises:
            ConfigurationError: a link or a figure that cannot be, or a change that was not made.
        """

    def put_back(self, name: str) -> None:
        """Make a link as it was planned; errors as `change`."""
