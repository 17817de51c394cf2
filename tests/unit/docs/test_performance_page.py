"""The page about performance: what it computes from its tables is what these have."""

from __future__ import annotations

import re
from pathlib import Path

PAGE = Path(__file__).resolve().parents[3] / "docs" / "performance.md"


def _section(heading: str) -> str:
    return PAGE.read_text(encoding="utf-8").split(f"## {heading}\n", 1)[1].split("\n## ", 1)[0]


def test_delayed_acknowledgements_save_at_most_what_the_table_has() -> None:
    section = _section("Lean TCP")
    row = r"^\| `five-states.*\| ([\d.,]+) \| [\d.,]+ \| ([\d.]+)/s, ([\d,]+) B/s \| ([\d.]+)/s \|$"
    rows = [[float(one.replace(",", "")) for one in found] for found in re.findall(row, section, re.MULTILINE)]
    assert len(rows) == 4
    most = max(followed * bytes_ / bare / total for total, bare, bytes_, followed in rows)
    assert f"**Delayed acknowledgements: {100 * most:.1f} % at most.**" in section


def test_commands_and_words_are_as_many_times_mavlinks_bytes_as_the_text_says_it_sends() -> None:
    section = _section("Words together")
    said = re.search(r"([\d,]+) B in the median attempt on `lte`, ([\d,]+) B on `lossy`", section)
    assert said is not None
    mavlink = dict(zip(("lte", "lossy"), (int(one.replace(",", "")) for one in said.groups()), strict=True))
    rows = re.findall(r"^\| `(lte|lossy)` .* \| ([\d,]+) B \| \**([\d.]+)\** \|$", section, re.MULTILINE)
    assert len(rows) == 4
    for profile, total, ratio in rows:
        assert f"{int(total.replace(',', '')) / mavlink[profile]:.2f}" == ratio
