"""The interface of links that a page also shows and changes, where its program has some, such as a testbed's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True)
class LinkFigures:
    """The present figures of one direction of a link.

    Parameters:
        name: the name of link and direction, such as `air:uav3:up`.
        packets_per_s: the recent traffic into it, in frames per second.
        bytes_per_s: the same in bytes per second.
        rate_bps: bits per second; None: unlimited.
        delay_ms: milliseconds, one way.
        loss: the share of frames that is lost, 0 to 1.
        is_closed: nothing passes.
        is_changed: the figures differ from the planned ones.
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
    """The links of a page. Their methods are called in a thread, one at a time."""

    @property
    def title(self) -> str:
        """The traffic that they carry, such as `MQTT-XT`."""

    def look(self) -> list[LinkFigures]:
        """The figures of every direction of every link; raises nothing."""

    def change(self, name: str, figures: Mapping[str, str], closed: bool) -> None:
        """Change a link, both directions alike; figures that are not named stay.

        Parameters:
            name: the link's name, such as `air:uav3`.
            figures: `rate`, `delay` and `loss` with their units, such as `64kbit`, `200ms` and `20%`.
            closed: whether nothing passes.

        Raises:
            ConfigurationError: an invalid link or figure, or a change that failed.
        """

    def put_back(self, name: str) -> None:
        """Restore a link's planned figures; errors as `change`."""
