"""The message set's traffic: the ratio of MAVLink's to MQTT-XT's for each kind, here and in the thesis."""

from __future__ import annotations

from dataclasses import dataclass, field

from ....numbers import words
from .axes import Scale, bottom, decades, log_bounds
from .draw import TEXT, Drawing, width_of
from .figure import Figure

PANELS = ("packets", "bytes")


@dataclass(frozen=True)
class Ratio:
    """MAVLink / MQTT-XT for a kind: with all frames, with its own frames alone, and in the thesis."""

    with_states: float | None
    alone: float | None
    thesis: float | None
    contradicted: bool = False
    """Whether the thesis's own figures contradict its ratio."""
    amounts: dict[str, dict[str, float]] = field(default_factory=dict)
    """The amounts per message, by the ratio's name and protocol."""


RatiosByKind = dict[str, dict[str, Ratio]]
"""By kind the ratios of packets and of bytes."""
_MARKS = (("with_states", "all on the links"), ("alone", "its own frames"), ("thesis", "thesis"))


def kind_ratios(kinds: RatiosByKind) -> Figure | None:
    """The figure of ratios by kind; None if no kind has both sides."""
    here = {
        name: by
        for name, by in kinds.items()
        if any(one.with_states is not None or one.alone is not None for one in by.values())
    }
    if not here:
        return None
    return Figure(
        name="ratio-by-kind",
        title="Traffic of each kind, MAVLink over MQTT-XT",
        shows=f"How many times MQTT-XT's packets and bytes MAVLink's are: {_said(here)}.",
        note=(
            "Right of 1 MAVLink takes more, left of it less, on a logarithmic scale. Filled: all that went over the "
            "links within the kind's calls or time. Grey: its own messages, their answers and acknowledgements alone. "
            "Hollow: the thesis, which counted all; struck through where its bytes for MQTT-XT are its packets times a "
            "constant."
        ),
        draw=lambda width: _draw(here, width),
        header=("kind", "what", "counted", "mqttxt", "mavlink", "ratio"),
        rows=tuple(
            (
                name,
                what,
                counted,
                *(by[what].amounts.get(counted, {}).get(p) for p in ("mqttxt", "mavlink")),
                _rounded(getattr(by[what], counted)),
            )
            for name, by in here.items()
            for what in PANELS
            for counted, _ in _MARKS
        ),
        sources=("pcap", "events.jsonl"),
    )


def _rounded(ratio: float | None) -> float | None:
    return None if ratio is None else float(f"{ratio:.6g}")


def _said(kinds: RatiosByKind) -> str:
    return "; ".join(
        f"{name} {words.ratio(by['packets'].with_states)} times the packets, "
        f"{words.ratio(by['packets'].alone)} times of its own"
        for name, by in kinds.items()
    )


def _draw(kinds: RatiosByKind, width: float) -> Drawing:
    narrow = width < 600
    row, top, left, gap = 27.0, 52.0, 92.0, 34.0
    high = row * len(kinds)
    one_high = top + high + 26
    drawing = Drawing(width, one_high * (2 if narrow else 1) - (0 if narrow else 4))
    _legend(drawing)
    wide = width - left - 14 if narrow else (width - left - gap - 14) / 2
    values = [v for by in kinds.values() for one in by.values() for v in (one.with_states, one.alone, one.thesis) if v]
    low, most = log_bounds([*values, 1.0])
    for number, what in enumerate(PANELS):
        x = left if narrow else left + number * (wide + gap)
        y = top + (number * one_high if narrow else 0)
        across = Scale(low, most, x, x + wide, logarithmic=True)
        drawing.text(x, y - 12, what, "ink", bold=True)
        bottom(drawing, across, decades(low, most, lambda v: f"{v:g}×", 6), y + high - 4, y - 4)
        drawing.line((across(1.0), y - 4), (across(1.0), y + high - 4), "faint", 1.6)
        for place, (name, by) in enumerate(kinds.items()):
            middle = y + place * row + row / 2 - 4
            if number == 0 or narrow:
                drawing.text(left - 10, middle + 4, name, "ink", "end")
            drawing.line((x, y + (place + 1) * row - 4), (x + wide, y + (place + 1) * row - 4), "edge")
            _draw_marks(drawing, f"{name}, {what}", by[what], across, middle)
    return drawing


def _draw_marks(drawing: Drawing, about: str, one: Ratio, across: Scale, y: float) -> None:
    known = [value for value in (one.with_states, one.alone) if value]
    if len(known) == 2:
        drawing.line((across(min(known)), y), (across(max(known)), y), "faint", 1.2)
    if one.thesis:
        drawing.dot(
            (across(one.thesis), y), "ink", 4.2, hollow=True, tip=f"thesis, {about}: {words.ratio(one.thesis)}×"
        )
        if one.contradicted:
            drawing.line((across(one.thesis) - 8, y), (across(one.thesis) + 8, y), "bad", 2)
    if one.alone:
        drawing.dot((across(one.alone), y), "faint", 4.2, tip=f"{about}, its own frames: {words.ratio(one.alone)}×")
    if one.with_states:
        tip = f"{about}, all on the links: {words.ratio(one.with_states)}×"
        drawing.dot((across(one.with_states), y), "ink", 4.2, tip=tip)


def _legend(drawing: Drawing) -> None:
    x = 0.0
    for counted, said in _MARKS:
        drawing.dot((x + 4, 9), "faint" if counted == "alone" else "ink", 4, hollow=counted == "thesis")
        drawing.text(x + 13, 13, said, "ink", size=TEXT)
        x += 13 + width_of(said) + 16
