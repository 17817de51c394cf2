"""Packet sizes, in the bins of Wireshark and of the thesis."""

from __future__ import annotations

from ....numbers import words
from ....plan import wording
from .axes import Scale, legend
from .draw import TEXT, Drawing, width_of
from .figure import Figure

BINS = ((0, 19), (20, 39), (40, 79), (80, 159), (160, 319), (320, 639), (640, 1279), (1280, 2559), (2560, 5119))


def histogram(counts: dict[str, tuple[int, ...]]) -> Figure | None:
    """The figure of packet sizes; None without frames. `counts` has each side's frames by bin."""
    used = [place for place in range(len(BINS)) if any(by_bin[place] for by_bin in counts.values())]
    if not used:
        return None
    places = range(used[0], used[-1] + 1)
    sums = {protocol: sum(by_bin) for protocol, by_bin in counts.items()}
    most = {p: max(places, key=lambda place: counts[p][place]) for p in counts if sums[p]}
    said = [f"most over {wording.name_of(p)} are {name_of_bin(place)} bytes" for p, place in most.items()]
    return Figure(
        name="packet-sizes",
        title="Packet sizes",
        shows=f"Share of each side's packets by size: {wording.listed(said)}.",
        note=(
            "Whole Ethernet frames without their check sequence, on all links, in Wireshark's bins. Bars are shares of "
            "each side's own packets, so that shapes compare; the number behind a bar is its count."
        ),
        draw=lambda width: _draw(counts, list(places), sums, width),
        header=("protocol", "from_bytes", "to_bytes", "packets", "share"),
        rows=tuple(
            (p, *BINS[place], by_bin[place], round(by_bin[place] / sums[p], 6) if sums[p] else None)
            for p, by_bin in counts.items()
            for place in places
        ),
        sources=("pcap",),
    )


def name_of_bin(place: int) -> str:
    return f"{BINS[place][0]}–{BINS[place][1]}"


def _draw(counts: dict[str, tuple[int, ...]], places: list[int], sums: dict[str, int], width: float) -> Drawing:
    bar, left, top = 13.0, 84.0, 26.0
    row = len(counts) * (bar + 2) + 12
    drawing = Drawing(width, top + row * len(places) + 2)
    legend(drawing, list(counts))
    most = max(by_bin[place] / sums[p] for p, by_bin in counts.items() if sums[p] for place in places)
    room = width_of("1,000,000 (100 %)")
    share = Scale(0, most, left, width - room)
    for number, place in enumerate(places):
        y = top + number * row
        drawing.text(left - 8, y + row / 2 - 2, f"{name_of_bin(place)} B", "soft", "end")
        for order, (protocol, by_bin) in enumerate(counts.items()):
            part = by_bin[place] / sums[protocol] if sums[protocol] else 0.0
            at = y + order * (bar + 2)
            tip = f"{wording.name_of(protocol)}, {name_of_bin(place)} bytes: {by_bin[place]:,} packets"
            if by_bin[place]:
                drawing.rect(left, at, max(share(part) - left, 1), bar, protocol, 0.85, tip)
            said = f"{by_bin[place]:,} ({words.percent(100 * part)})" if by_bin[place] else "0"
            drawing.text(share(part) + 6, at + bar - 2.5, said, "soft", size=TEXT - 1)
        drawing.line((left, y - 3), (left, y + row - 9), "faint")
    return drawing
