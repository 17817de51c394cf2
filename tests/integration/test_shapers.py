"""A kernel's netem and the emulator make the same links of a plan: both in virtual machines, by the same probe.

The machines' time is their own, but two runs differ by up to a millisecond; what is compared is in tests/shapers.
"""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import pytest

from tests.shapers.comparison import Row, compare, features
from tests.shapers.machine import Machine
from tests.shapers.rounds import job, rounds

pytestmark = [
    pytest.mark.long,
    pytest.mark.timeout(900),
    pytest.mark.soak(
        *("services/net/src", "testbed/plan/profiles", "tests/tools/machine.py"),
        *("tc_profiles", "tests/shapers"),
    ),
]
ROUNDS = rounds()


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], dict[str, Any]]:
    """The kernel's and the emulator's."""
    folder: Path = tmp_path_factory.mktemp("machines")
    with contextlib.ExitStack() as ending:
        machines = [Machine(folder / shaper, job(shaper, ROUNDS)) for shaper in ("netem", "nfqueue")]
        for machine in machines:
            ending.callback(machine.end)
        kernel, emulator = (machine.result() for machine in machines)
    return kernel, emulator


@pytest.fixture(scope="module")
def rows(results: tuple[dict[str, Any], dict[str, Any]]) -> dict[str, list[Row]]:
    return compare(ROUNDS, *results)


def test_neither_lost_a_frame_but_by_the_plan(results: tuple[dict[str, Any], dict[str, Any]]) -> None:
    voided = [each["counters"]["void"] for result in results for each in result["rounds"]]
    assert set(voided) == {None}


@pytest.mark.parametrize("feature", features(ROUNDS))
def test_the_emulators_link_is_the_kernels(feature: str, rows: dict[str, list[Row]]) -> None:
    assert rows[feature], feature
    apart = [str(row) for row in rows[feature] if not row.agrees]
    assert not apart, "\n".join(apart)
