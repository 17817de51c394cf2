"""What docs/mavlink.md says of streams and system ids is what the code and compose.yaml have."""

from __future__ import annotations

import re

from sitl.streams import rates_hz
from testbed.topology import ROOT, read_services

PAGE = (ROOT / "docs" / "mavlink.md").read_text()
ASKED_FOR = {"BATTERY_STATUS": 1.0, "GLOBAL_POSITION_INT": 1.0, "VFR_HUD": 1.0}
"""What the ground station asks for in five-states, beside the heartbeats."""


def test_the_streams_table_is_the_stand_ins() -> None:
    told: dict[str, dict[str, float]] = {"px4-onboard": {}, "px4-gcs": {}, "five-states": {}}
    rows = PAGE.partition("| message | px4-onboard | px4-gcs | five-states |\n|---|---|---|---|\n")[2]
    for row in rows.partition("\n\n")[0].splitlines():
        names, *cells = (cell.strip() for cell in row.strip("|").split("|"))
        for chosen, cell in zip(told, cells, strict=True):
            of_all = re.fullmatch(r"([\d.]*)", cell)
            for name in names.split(", "):
                own = re.search(rf"{name} ([\d.]+)", cell)
                value = own[1] if own else of_all[1] if of_all else ""
                if value:
                    told[chosen][name] = float(value)
    for chosen, rates in told.items():
        streamed = {name: hz for name, hz in rates_hz(chosen).items() if hz > 0}
        assert rates == (streamed | ASKED_FOR if chosen == "five-states" else streamed), chosen


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
