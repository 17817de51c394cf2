"""Checks beyond the schema: figures of one link that do not fit together."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ...errors import UserError
from .reading import PARSERS, EventRule, ProfileFigure


def check_link(link: Mapping[str, Any], figures: Mapping[str, ProfileFigure]) -> None:
    """Raise UserError that names a figure which does not fit the others; `link` has the plan's fields."""
    problem = unfitting(link)
    if problem is not None:
        name, expected = problem
        figure = figures[name]
        raise UserError(f"{figure.where}: {figure.text!r}: expected {expected}")


def check_event(link: Mapping[str, Any], rule: EventRule, change: Mapping[str, Any]) -> None:
    """As `check_link`, for the figures during an event."""
    if "rate_bps" in change and link["shared_with"] is not None and rule.link.endswith((":up", ":down")):
        text = rule.change["rate_bps"].text
        raise UserError(f"{rule.where}.change.rate: {text!r}: expected the whole link, its directions share a rate")
    problem = unfitting({**link, **change})
    if problem is not None:
        name, expected = problem
        figure = rule.change.get(name)
        written = next((text for text, (field, _) in PARSERS.items() if field == name), name)
        text = "not changed" if figure is None else repr(figure.text)
        raise UserError(f"{rule.where}.change.{written}: {text}: expected {expected}")


def unfitting(link: Mapping[str, Any]) -> tuple[str, str] | None:
    """The first figure of a link, as plan field, that does not fit the others, and what was expected, or None."""
    if link["rate_bps"] is not None and link["queue_packets"] is None:
        return "rate_bps", "a queue beside it, as queue: 100 packets"
    if link["rate_bps"] is None and link["queue_packets"] is not None:
        return "queue_packets", "a rate beside it that it waits for"
    if link["jitter_us"] > link["delay_us"]:
        return "jitter_us", "at most the delay"
    if link["reorder"] and not link["delay_us"]:
        return "reorder", "a delay that a reordered frame does not wait for"
    return None
