"""What docs/mavlink.md says of system ids is what compose.yaml has."""

from __future__ import annotations

import re

from testbed.plan.compose import read_services
from testbed.plan.documents import ROOT

PAGE = (ROOT / "docs" / "mavlink.md").read_text()


def test_every_router_has_the_system_id_that_the_page_gives_its_node() -> None:
    firsts = {"gs": 201, "cloud": 211, "fog1": 221, "fog2": 221, "uav": 231}
    ids: list[int] = []
    for name, service in read_services().items():
        if not name.startswith("router-"):
            continue
        first = firsts[name.removeprefix("router-").rstrip("123456") if "uav" in name else name.removeprefix("router-")]
        own = [int(found) for found in re.findall(r"--hb-systemid=(\d+)", service["environment"]["PER_UAV"])]
        assert all(first <= number <= first + 5 for number in own), name
        ids += own
    assert len(set(ids)) == len(ids) == 24
    assert "201 to 206 on gs, 211 to 216 on the cloud, 221 to 226 on the fogs, 231 to 236 on the UAVs" in PAGE
