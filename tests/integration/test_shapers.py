"""A kernel's netem and the emulator make the same links of a plan: both in virtual machines, by the same probe.

The machines' time is their own, so a busy computer changes nothing; what is compared is in tests/shapers.
"""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import pytest

from testbed.profiles.kernel import RATE_DEVICE, directed_links
from tests.shapers.comparison import Row, compare, features
from tests.shapers.machine import Machine
from tests.shapers.rounds import job, rounds, topology

pytestmark = [pytest.mark.integration, pytest.mark.timeout(900)]
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


def test_the_kernel_has_what_the_plan_says(results: tuple[dict[str, Any], dict[str, Any]]) -> None:
    for each, result in zip(ROUNDS, results[0]["rounds"], strict=True):
        shown = {(qdisc["dev"], qdisc["handle"]): qdisc["options"] for qdisc in result["counters"]["qdiscs"]}
        for link in directed_links(each.plan, topology()):
            plan = each.plan.links[link.name]
            options = shown[link.device, "1:"]
            assert options["limit"] == link.limit
            assert options.get("delay", {}).get("delay", 0) == pytest.approx(plan.delay_us / 1e6)
            assert options.get("delay", {}).get("jitter", 0) == pytest.approx(plan.jitter_us / 1e6)
            assert options.get("loss-random", {}).get("loss", 0) == pytest.approx(plan.loss)
            if plan.rate_bps is not None:
                first = shown[RATE_DEVICE, f"{0x200 + link.number:x}:"]
                assert first["limit"] == plan.queue_packets
                assert first["rate"]["rate"] * 8 == plan.rate_bps


@pytest.mark.parametrize("feature", features(ROUNDS))
def test_the_emulators_link_is_the_kernels(feature: str, rows: dict[str, list[Row]]) -> None:
    assert rows[feature], feature
    apart = [str(row) for row in rows[feature] if not row.agrees]
    assert not apart, "\n".join(apart)
