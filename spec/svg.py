"""Draws boxes, lines and text as SVG that looks the same on light and dark pages."""

from __future__ import annotations

from xml.sax.saxutils import escape

STYLE = """\
text { font: 13px system-ui, sans-serif; fill: #1b2430; }
.small { font-size: 11.5px; fill: #56616e; } .title { font-weight: 600; }
.code { font: 11.5px ui-monospace, monospace; }
.mqttxt { fill: #0b7a75; } .mavlink { fill: #c2570c; }
.paper { fill: #ffffff; } .box { fill: #f3f6f9; stroke: #8a97a6; } .room { fill: #e4f1f0; stroke: #0b7a75; }
.halo { paint-order: stroke; stroke: #ffffff; stroke-width: 5; }
.line { stroke: #56616e; stroke-width: 1.4; fill: none; } .dashed { stroke-dasharray: 4 4; }
"""


class Drawing:
    """A picture of `width` by `height` pixels, y downwards; later parts cover earlier ones."""

    def __init__(self, width: int, height: int, title: str) -> None:
        self.width, self.height, self.title = width, height, title
        self._parts: list[str] = []
        self.box(0, 0, width, height, "paper")

    def box(self, x: float, y: float, width: float, height: float, kind: str = "box") -> None:
        self._parts.append(f'<rect class="{kind}" x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" rx="5"/>')

    def text(self, x: float, y: float, words: str, kind: str = "", anchor: str = "start") -> None:
        """Add a text; `y` is its baseline, `anchor` is start, middle or end."""
        self._parts.append(f'<text class="{kind}" x="{x:g}" y="{y:g}" text-anchor="{anchor}">{escape(words)}</text>')

    def line(
        self, start: tuple[float, float], end: tuple[float, float], *, arrow: bool = False, dashed: bool = False
    ) -> None:
        kind = "line dashed" if dashed else "line"
        head = ' marker-end="url(#head)"' if arrow else ""
        self._parts.append(
            f'<line class="{kind}" x1="{start[0]:g}" y1="{start[1]:g}" x2="{end[0]:g}" y2="{end[1]:g}"{head}/>'
        )

    def svg(self) -> str:
        head = (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {self.width} {self.height}" '
            f'width="{self.width}" height="{self.height}" role="img">'
        )
        marker = (
            '<marker id="head" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="8" markerHeight="8" orient="auto">'
            '<path d="M0 0 8 4 0 8z" fill="#56616e"/></marker>'
        )
        parts = [
            head,
            f"<title>{escape(self.title)}</title>",
            f"<style>\n{STYLE}</style>",
            f"<defs>{marker}</defs>",
            *self._parts,
            "</svg>",
        ]
        return "\n".join(parts) + "\n"
