"""A drawing as a PDF for papers, seven inches wide, in the light colours: text stays text, fonts are embedded."""

from __future__ import annotations

import io

from .draw import Dot, Drawing, DrawnText, diamond

INCHES = 7.0
LIGHT = {
    "ink": "#000000", "soft": "#444444", "faint": "#777777", "edge": "#cccccc", "wash": "#f0f0f0",
    "paper": "#ffffff", "good": "#14663c", "bad": "#a01f18", "mqttxt": "#0b6a66", "mavlink": "#b8500a",
    "l0": "#17324d", "l1": "#2f6690", "l2": "#6fa3c7", "l3": "#acc8da", "l4": "#d9e4ea", "l5": "#b9b2a3",
    "l6": "#d8cfbd",
}  # fmt: skip
_FONT = 0.9
"""The factor on text sizes: matplotlib's font DejaVu is wider than the page's fonts."""


def pdf(drawing: Drawing, title: str) -> bytes:
    """Make a PDF. The same drawing gives the same bytes: it has no dates and no names of machines."""
    import matplotlib  # here, because it loads slowly and most of the report does not need it
    from matplotlib.backends.backend_pdf import FigureCanvasPdf
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.patches import Circle, Polygon

    scale = INCHES / drawing.width
    points = 72 * scale
    figure = Figure(figsize=(INCHES, drawing.height * scale))
    FigureCanvasPdf(figure)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, drawing.width), ylim=(drawing.height, 0))
    axes.set_axis_off()
    for order, mark in enumerate(drawing.marks):
        colour = LIGHT[mark.role]
        if isinstance(mark, DrawnText):
            axes.text(
                mark.x,
                mark.y,
                mark.words.replace("$", r"\$"),
                color=colour,
                fontsize=mark.size * points * _FONT,
                ha=mark.anchor.replace("start", "left").replace("middle", "center").replace("end", "right"),
                va="baseline",
                weight="bold" if mark.bold else "normal",
                zorder=order,
            )
        elif isinstance(mark, Dot):
            shape = Polygon(diamond(mark)) if mark.diamond else Circle((mark.x, mark.y), mark.radius)
            shape.set(facecolor=LIGHT["paper"] if mark.hollow else colour, edgecolor=colour, zorder=order)
            shape.set(linewidth=1.4 * points if mark.hollow else 0, alpha=mark.opacity)
            axes.add_patch(shape)
        elif mark.filled:
            axes.add_patch(Polygon(mark.points, facecolor=colour, linewidth=0, alpha=mark.opacity, zorder=order))
        else:
            line = Line2D(*zip(*mark.points, strict=True), color=colour, linewidth=mark.width * points, zorder=order)
            if mark.dashed:
                line.set_linestyle((0, (4, 3)))
            axes.add_line(line)
    target = io.BytesIO()
    with matplotlib.rc_context({"pdf.fonttype": 42, "font.family": "DejaVu Sans"}):
        figure.savefig(target, format="pdf", metadata={"Title": title, "CreationDate": None, "Producer": None})
    return target.getvalue()
