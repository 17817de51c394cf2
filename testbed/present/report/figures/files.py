"""The files next to a page: a figure's data as CSV, and the figure as a PDF for papers."""

from __future__ import annotations

from pathlib import Path

from .draw import WIDE
from .figure import Figure
from .pdf import pdf

FOLDER = "figures"


def write_files(folder: Path, figures: dict[str, Figure], papers: bool) -> None:
    """Write the figures' files into `folder`; its other CSV and PDF files are removed."""
    folder.mkdir(exist_ok=True)
    for old in [*folder.glob("*.csv"), *folder.glob("*.pdf")]:
        old.unlink()
    for name, figure in figures.items():
        write_figure(folder / name, figure, papers)


def write_figure(base: Path, figure: Figure, papers: bool = True) -> None:
    """Write a figure's files, named as `base` is, each with its own suffix."""
    base.with_suffix(".csv").write_text(figure.csv(), encoding="utf-8")
    if papers:
        base.with_suffix(".pdf").write_bytes(pdf(figure.draw(WIDE), figure.title))
