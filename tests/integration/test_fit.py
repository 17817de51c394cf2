"""The thesis profile's fit holds on the real shaper: what a replayed stream loses there is what the simulation says."""

from __future__ import annotations

import json
import time
from dataclasses import asdict
from pathlib import Path

import pytest

from testbed.plan.documents import ROOT
from testbed.plan.fleets import standard_fleet
from testbed.plan.profiles.reading import read_profile
from testbed.plan.profiles.resolve import resolve
from tests.bench.fit_simulation import cross
from tests.bench.fit_streams import exact
from tests.rigs.shaped_link import SUBNETS, UP, Emulator, ShapedLink
from tests.rigs.shaped_nodes import PYTHON, READY_TIMEOUT_S

pytestmark = [
    pytest.mark.integration,
    pytest.mark.alone,
    pytest.mark.timeout(120),
    pytest.mark.soak(
        *("services/net/src", "services/sitl/src/sitl/px4/streams.py", "testbed/plan/profiles"),
        *(f"tests/bench/fit_{name}.py" for name in ("sender", "simulation", "streams")),
        *("tc_profiles/thesis.yaml", "tests/rigs/shaped_link.py", "tests/rigs/shaped_nodes.py"),
    ),
]
SENDER = "/repository/tests/bench/fit_sender.py"
SECONDS = 6.0
TOLERANCE = 0.01
"""Of all frames. The simulation is of the times at which frames were really sent, so a busy machine is no excuse."""


def test_one_uavs_stream_loses_on_the_real_air_what_the_simulation_says(link: ShapedLink) -> None:
    plan = resolve(read_profile("thesis"), standard_fleet().topology(), "scenario-1", 1)
    air = plan.links["air:uav1:up"]
    stream = exact("px4-onboard", SECONDS)
    file = ROOT / ".cache" / "fit" / "one-uav.json"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps([frame[:2] for frame in stream]))
    with link.shaping(asdict(air)) as emulator:
        inside = str(Path("/repository") / file.relative_to(ROOT))
        begin_ns = time.monotonic_ns() + 200_000_000
        said = link.output("gs", [PYTHON, SENDER, "send", inside, f"{SUBNETS['cloud']}.3", str(begin_ns)])
        found = _counts_of_all(emulator)
    sent = [
        (t_ns, frame.size, number) for number, (t_ns, frame) in enumerate(zip(json.loads(said), stream, strict=True))
    ]
    expected = cross(UP, air, sent, plan.seed)
    assert found["overload"] == 0
    assert found["entered"] == len(stream)
    assert expected.queue > 0.04 * len(stream), "the profile overfills the way up"
    assert found["queue"] == pytest.approx(expected.queue, abs=len(stream) * TOLERANCE)


def _counts_of_all(emulator: Emulator) -> dict[str, int]:
    """What the way up counted once nothing is on its way."""
    deadline = time.monotonic() + READY_TIMEOUT_S
    while True:
        found: dict[str, int] = emulator.counters()["links"][UP]
        if found["entered"] == found["left"] + found["queue"] + found["random"] > 0:
            return found
        assert time.monotonic() < deadline, found
        time.sleep(0.1)
