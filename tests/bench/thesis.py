"""Writes into a page the loss of the stand-in's streams on `thesis`: `python -m tests.bench.thesis FILE`.

It is simulated, with every tick of the autopilot on time, so that the same code gives the same figures.
"""

from __future__ import annotations

import sys
from pathlib import Path

from testbed.plan.fleets import standard_fleet
from testbed.plan.profiles.reading import read_profile
from testbed.plan.profiles.resolve import resolve
from tests.bench.fit_search import SETTLED_NS
from tests.bench.fit_simulation import Offered, losses, run
from tests.bench.fit_streams import exact, load_of

BEGIN, END = "<!-- simulated: thesis -->", "<!-- end -->"
SECONDS = 60.0


def main(page: Path) -> None:
    before, _, rest = page.read_text(encoding="utf-8").partition(BEGIN)
    _, _, after = rest.partition(END)
    page.write_text(f"{before}{BEGIN}{sentence()}{END}{after}", encoding="utf-8")


def sentence() -> str:
    """A sentence about one UAV's onboard streams in flight, and their loss on the way to the ground station."""
    plan = resolve(read_profile("thesis"), standard_fleet().topology(), "scenario-1", 1)
    stream = exact("px4-onboard", SECONDS)
    offered = Offered({1: stream}, standard_fleet().fogs)
    found, load = losses(offered, run(offered, plan.links, plan.seed), SETTLED_NS), load_of(stream)
    return (
        f"The stand-in of now sends {load.frames_s:.0f} messages a second in flight, {load.kbit_s:.0f} kbit/s, and the "
        f"simulation loses {100 * found.end_to_end:.1f} % of one UAV's: {round(found.end_to_end * found.sent):,} of "
        f"{found.sent:,} frames."
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
