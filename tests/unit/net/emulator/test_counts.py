"""What the emulator says of a run: counts a link and cause, and whether it kept up."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from net.emulator.counts import Writer, report
from net.emulator.link import EmulatedLink
from net.emulator.plan import Settings
from net.emulator.timing import Lateness

LINKS = [EmulatedLink(name, Settings(), 1) for name in ("wan:gs:up", "wan:gs:down")]


def late(*all_ms: float) -> Lateness:
    found = Lateness()
    for ms in all_ms:
        found.add(int(ms * 1_000_000))
    return found


def test_lateness_is_told_by_quantiles() -> None:
    found = late(*[0.1] * 98, 5.0, 700.0)
    assert 0.1 <= found.quantile_ms(0.5) <= 0.12
    assert 5.0 <= found.quantile_ms(0.99) <= 5.02
    assert found.quantile_ms(1.0) == 700.0  # beyond the last step
    assert Lateness().quantile_ms(0.99) == 0.0


def test_a_run_that_it_kept_up_with_stands(tmp_path: Path) -> None:
    content = report("lte", LINKS, {}, overruns=0, late=late(0.1, 0.2), held=4)
    assert content["void"] is None
    assert content["held"] == 4
    writer = Writer(tmp_path / "counters.json")
    writer.write(content)
    writer.finish(content)
    assert [path.name for path in tmp_path.iterdir()] == ["counters.json"]
    assert json.loads((tmp_path / "counters.json").read_text())["links"]["wan:gs:up"]["entered"] == 0


def test_packets_that_the_kernel_dropped_void_the_run() -> None:
    content = report("lte", LINKS, {1: 7}, overruns=1, late=late(), held=0)
    assert content["links"]["wan:gs:down"]["overload"] == 7
    assert content["void"] == "the emulator did not keep up: packets lost to overload: wan:gs:down 7"


def test_packets_that_left_too_late_void_the_run() -> None:
    content = report("lte", LINKS, {}, overruns=0, late=late(*[0.1] * 50, 25.0), held=0)
    assert content["void"] == "the emulator did not keep up: 25.0 ms late at p99; expected 10 at most"


def test_a_file_that_cannot_be_written_is_an_error_at_the_next_chance(tmp_path: Path) -> None:
    writer = Writer(tmp_path / "nowhere" / "counters.json")
    writer.write({})
    with pytest.raises(FileNotFoundError):
        writer.finish({})
