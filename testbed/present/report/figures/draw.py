"""A drawing as a list of marks, and as SVG: colours are roles, whose values the page's light and dark styles set.

Lengths are CSS pixels, y points down. `pdf.py` makes a PDF of the same drawing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape

Point = tuple[float, float]

TEXT = 12.5
"""The text size, in pixels at the drawing's own width."""
NARROW, WIDE = 360.0, 920.0
"""The widths at which figures are drawn, for phones and for all other screens."""


@dataclass(frozen=True)
class DrawnPath:
    """A line through points, or, if filled, the shape that they enclose."""

    points: tuple[Point, ...]
    role: str
    width: float = 1.6
    filled: bool = False
    dashed: bool = False
    opacity: float = 1.0
    tip: str = ""


@dataclass(frozen=True)
class Dot:
    """A round mark or a diamond, filled or hollow."""

    x: float
    y: float
    radius: float
    role: str
    diamond: bool = False
    hollow: bool = False
    opacity: float = 1.0
    tip: str = ""


@dataclass(frozen=True)
class DrawnText:
    """A line of text; `y` is its baseline, `anchor` start, middle or end."""

    x: float
    y: float
    words: str
    role: str = "soft"
    size: float = TEXT
    anchor: str = "start"
    bold: bool = False


Mark = DrawnPath | Dot | DrawnText


@dataclass
class Drawing:
    """A width, a height, and marks, the last on top."""

    width: float
    height: float
    marks: list[Mark] = field(default_factory=list)

    @property
    def narrow(self) -> bool:
        return self.width < (NARROW + WIDE) / 2

    def line(self, start: Point, end: Point, role: str = "edge", width: float = 1.0, dashed: bool = False) -> None:
        self.marks.append(DrawnPath((start, end), role, width, dashed=dashed))

    def path(self, points: Sequence[Point], role: str, width: float = 1.6, dashed: bool = False, tip: str = "") -> None:
        if len(points) > 1:
            self.marks.append(DrawnPath(tuple(points), role, width, dashed=dashed, tip=tip))

    def area(self, points: Sequence[Point], role: str, opacity: float = 1.0, tip: str = "") -> None:
        self.marks.append(DrawnPath(tuple(points), role, filled=True, opacity=opacity, tip=tip))

    def rect(
        self, x: float, y: float, width: float, height: float, role: str, opacity: float = 1.0, tip: str = ""
    ) -> None:
        corners = ((x, y), (x + width, y), (x + width, y + height), (x, y + height))
        self.area(corners, role, opacity, tip)

    def dot(self, at: Point, role: str, radius: float = 3.2, hollow: bool = False, tip: str = "") -> None:
        """Add a mark; MAVLink's are diamonds, so that the sides differ without colour too."""
        self.marks.append(Dot(*at, radius, role, diamond=role == "mavlink", hollow=hollow, tip=tip))

    def text(
        self,
        x: float,
        y: float,
        words: str,
        role: str = "soft",
        anchor: str = "start",
        size: float = TEXT,
        bold: bool = False,
    ) -> None:
        self.marks.append(DrawnText(x, y, words, role, size, anchor, bold))


def width_of(words: str, size: float = TEXT) -> float:
    """The approximate width of a line of text, in pixels; rather too large than too small."""
    return sum(0.34 if c in " .,:;|'()ijlftr–·" else 0.92 if c in "mwMW%" else 0.6 for c in words) * size


def svg(drawing: Drawing, name: str, title: str, description: str) -> str:
    """The drawing as SVG for a page: it scales with its container, has a description in words, and is reproducible."""
    inner = "\n".join(_svg_of(mark) for mark in drawing.marks)
    return (
        f'<svg viewBox="0 0 {_n(drawing.width)} {_n(drawing.height)}" role="img" '
        f'aria-labelledby="{name}-title {name}-desc"><title id="{name}-title">{escape(title)}</title>'
        f'<desc id="{name}-desc">{escape(description)}</desc>\n{inner}\n</svg>'
    )


def diamond(dot: Dot) -> tuple[Point, ...]:
    """The corners of a diamond; a little larger than the circle, so that both have the same visual weight."""
    r = 1.2 * dot.radius
    return ((dot.x, dot.y - r), (dot.x + r, dot.y), (dot.x, dot.y + r), (dot.x - r, dot.y))


def _svg_of(mark: Mark) -> str:
    if isinstance(mark, DrawnText):
        anchor = f' text-anchor="{mark.anchor}"' if mark.anchor != "start" else ""
        bold = ' font-weight="600"' if mark.bold else ""
        size = f' font-size="{_n(mark.size)}"' if mark.size != TEXT else ""
        place = f'x="{_n(mark.x)}" y="{_n(mark.y)}"'
        return f'<text class="f-{mark.role}" {place}{anchor}{size}{bold}>{escape(mark.words)}</text>'
    faded = f' opacity="{mark.opacity:g}"' if mark.opacity != 1 else ""
    if isinstance(mark, Dot) and not mark.diamond:
        shape = f'<circle cx="{_n(mark.x)}" cy="{_n(mark.y)}" r="{_n(mark.radius)}"'
    else:
        points = diamond(mark) if isinstance(mark, Dot) else mark.points
        closed = isinstance(mark, Dot) or mark.filled
        shape = f'<path d="{_route(points)}{"Z" if closed else ""}"'
    if isinstance(mark, Dot):
        look = f'class="h-{mark.role}"' if mark.hollow else f'class="f-{mark.role}"'
    elif mark.filled:
        look = f'class="f-{mark.role}"'
    else:
        look = f'class="s-{mark.role}" stroke-width="{_n(mark.width)}"'
        look += ' stroke-dasharray="4 3"' if mark.dashed else ""
    ending = f"><title>{escape(mark.tip)}</title></{shape[1 : shape.index(' ')]}>" if mark.tip else "/>"
    return f"{shape} {look}{faded}{ending}"


def _route(points: Sequence[Point]) -> str:
    """The SVG path through points; horizontal and vertical lines in their short form."""
    x, y = points[0]
    said = [f"M{_n(x)} {_n(y)}"]
    for to_x, to_y in points[1:]:
        if _n(to_y) == _n(y):
            said.append(f"H{_n(to_x)}")
        elif _n(to_x) == _n(x):
            said.append(f"V{_n(to_y)}")
        else:
            said.append(f"L{_n(to_x)} {_n(to_y)}")
        x, y = to_x, to_y
    return "".join(said)


def _n(value: float) -> str:
    """A length with a precision of a tenth of a pixel."""
    text = f"{value:.1f}".removesuffix(".0")
    return "0" if text == "-0" else text
