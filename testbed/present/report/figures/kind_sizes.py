"""The message set's packet sizes: all frames while a kind was measured, in Wireshark's bins."""

from __future__ import annotations

from ....numbers import words
from ....numbers.attempt_entry import AttemptEntry
from ....plan import wording
from .axes import Scale
from .draw import TEXT, Drawing
from .figure import Figure
from .panels import begin, lay_out
from .sizes import BINS, name_of_bin

Counts = dict[str, dict[str, tuple[int, ...]]]
"""By kind and protocol the frames in each of BINS."""
_BAR, _BELOW, _LEFT = 8.0, 42.0, 84.0


def counts_of(completed: dict[str, list[AttemptEntry]], order: tuple[str, ...]) -> Counts:
    """Sum the frames of each side's completed attempts."""
    found: Counts = {}
    for name in order:
        for protocol, attempts in completed.items():
            told = [kind["size_histogram"] for one in attempts if (kind := (one["message_set"] or {}).get(name))]
            sums = tuple(sum(bins.get(f"{least}-{most}", 0) for bins in told) for least, most in BINS)
            if any(sums):
                found.setdefault(name, {})[protocol] = sums
    return found


def kind_sizes(counts: Counts) -> Figure | None:
    """The figure of sizes by kind; None without frames."""
    if not counts:
        return None
    used = [place for place in range(len(BINS)) if any(bins[place] for by in counts.values() for bins in by.values())]
    places = list(range(used[0], used[-1] + 1))
    return Figure(
        name="sizes-by-kind",
        title="Packet sizes while a kind was on",
        shows=f"Share of each side's packets by size, kind by kind: {_said(counts)}.",
        note=(
            "All frames on all links within the kind's calls or time, without their check sequence, in Wireshark's "
            "bins. Bars are shares of each side's own frames; point at one for its count. An empty acknowledgement of "
            "TCP has 66 bytes."
        ),
        draw=lambda width: _draw(counts, places, width),
        header=("kind", "protocol", "from_bytes", "to_bytes", "packets", "share"),
        rows=tuple(
            (name, protocol, *BINS[place], bins[place], round(bins[place] / sum(bins), 6))
            for name, by in counts.items()
            for protocol, bins in by.items()
            for place in places
        ),
        sources=("pcap",),
    )


def _said(counts: Counts) -> str:
    parts = []
    for name, by in counts.items():
        most = [f"{name_of_bin(bins.index(max(bins)))} bytes over {wording.name_of(p)}" for p, bins in by.items()]
        parts.append(f"{name} most {wording.listed(most)}")
    return "; ".join(parts)


def _draw(counts: Counts, places: list[int], width: float) -> Drawing:
    protocols = [p for p in wording.PROTOCOL_NAMES if any(p in by for by in counts.values())]
    row = len(protocols) * (_BAR + 1) + 8
    panels = lay_out(list(counts), width, row * len(places), _BELOW, _LEFT)
    drawing = begin(panels, protocols, width, _BELOW)
    for panel in panels:
        share = Scale(0, 1, panel.x, panel.x + panel.wide - 4)
        for part in (0.5, 1.0):
            drawing.line((share(part), panel.y - 2), (share(part), panel.y + panel.high - 6), "edge")
            at = panel.y + panel.high + TEXT - 6
            drawing.text(share(part), at, f"{part:.0%}".replace("%", " %"), anchor="end" if part == 1 else "middle",
                         size=TEXT - 2)  # fmt: skip
        drawing.line((panel.x, panel.y - 2), (panel.x, panel.y + panel.high - 6), "faint")
        for number, place in enumerate(places):
            y = panel.y + number * row
            if panel.first:
                drawing.text(_LEFT - 8, y + row / 2, f"{name_of_bin(place)} B", "soft", "end", size=TEXT - 1)
            for order, protocol in enumerate(protocols):
                bins = counts[panel.name].get(protocol)
                if bins is None or not bins[place]:
                    continue
                part = bins[place] / sum(bins)
                tip = f"{wording.name_of(protocol)}, {panel.name}, {name_of_bin(place)} bytes: {bins[place]:,} packets"
                at = y + order * (_BAR + 1)
                drawing.rect(
                    panel.x, at, max(share(part) - panel.x, 1), _BAR, protocol, 0.85,
                    f"{tip}, {words.percent(100 * part)}",
                )  # fmt: skip
    return drawing
