"""The page of what more drones cost: its tables are those of the command, its costs those that its runs had."""

from __future__ import annotations

import shutil
from itertools import product
from pathlib import Path

import pytest

from spec import scale
from spec.scale import ROLES, RUNS, Cost, costs, hops, needs, read_runs
from testbed.plan.documents import ROOT

PAGE = ROOT / "docs" / "scale.md"
OF = {"activators": Cost(9e-3, 1e-4, 3e-4), "broker": Cost(0, 1e-4, 0), "station": Cost(1e-3, 3e-4, 7e-4)}


def made_up(fogs: int, drones: int, commands: int) -> dict[str, object]:
    """A run of a hundred seconds whose roles cost what `OF` says."""
    shares = {role: cost.cores(fogs, drones, commands / 100) for role, cost in OF.items()}
    return {"fogs": fogs, "drones": drones, "seconds": 100.0, "words": {"completed": commands}, "shares": shares}


def test_the_tables_are_what_the_command_writes(tmp_path: Path) -> None:
    copy = tmp_path / "scale.md"
    shutil.copyfile(PAGE, copy)
    shutil.copytree(PAGE.with_suffix(""), copy.with_suffix(""))
    scale.main(str(copy))
    assert copy.read_text() == PAGE.read_text(), "run make docs"


def test_no_command_of_any_run_was_lost_late_or_doubled() -> None:
    runs = [*read_runs(), *read_runs(RUNS.with_name("cluster.json"))]
    assert len(runs) > 6
    assert {(run["lost"], run["late"], run["doubled"]) for run in runs} == {(0, 0, 0)}


def test_a_run_has_its_median_delay_where_that_was_kept() -> None:
    known = read_runs()[0]
    old, new = scale.runs_table([known, known | {"median_s": 0.054}]).splitlines()[-2:]
    assert f"| –, {known['slowest_s']:.2f} s |" in old
    assert f"| 54 ms, {known['slowest_s']:.2f} s |" in new


def test_the_text_about_the_cluster_has_its_runs_figures() -> None:
    small, one, _ = read_runs(RUNS.with_name("cluster.json"))
    assert (small["cloud"], one["cloud"], small["drones"], one["drones"]) == ("cluster", "mosquitto", 250, 250)
    text = PAGE.read_text(encoding="utf-8").split("### On a cluster\n", 1)[1].split("\n## ", 1)[0]
    more = {role: 100 * (small["shares"][role] / one["shares"][role] - 1) for role in ("activators", "station")}
    words = [sum(run["words"].values()) for run in (small, one)]
    of_cluster, of_one = (sorted(round(each) for each in run["rss_mb"]["broker"]) for run in (small, one))
    assert f"takes {1000 * small['median_s']:.0f} ms in the median instead of {1000 * one['median_s']:.0f}" in text
    assert f"and {small['slowest_s']:.2f} s at most instead of {one['slowest_s']:.2f} s" in text
    assert (
        f"takes {100 * small['shares']['broker']:.0f} % of a core** and {of_cluster[0]} to {of_cluster[1]} MB" in text
    )
    assert f"takes {100 * one['shares']['broker']:.1f} % and {of_one[0]} MB" in text
    assert (
        f"take {more['activators']:.0f} % more than beside one Mosquitto, and the station {more['station']:.0f} %"
        in text
    )
    assert f"there were {100 * (words[0] / words[1] - 1):.0f} % more commands" in text


def test_the_text_about_a_machine_of_two_cores_has_its_runs_figures() -> None:
    before, last = (run for run in read_runs() if run["drones"] == 1000)
    text = PAGE.read_text(encoding="utf-8")
    assert last["words"] == {"completed": sum(last["words"].values())}
    assert (
        f"all of {last['words']['completed']:,} commands were completed, the slowest in {last['slowest_s']:.2f} s"
        in text
    )
    assert f"beside other programs, {before['words']['expired']:,} commands `expired`" in text


def test_costs_are_found_again_in_what_they_make() -> None:
    found = costs([made_up(*of) for of in product((2, 10), (20, 200), (100, 3000))])
    for role, cost in OF.items():
        assert vars(found[role]) == pytest.approx(vars(cost), abs=1e-9)


def test_no_cost_is_below_zero_where_a_run_was_cheaper_than_a_smaller_one() -> None:
    runs = [made_up(2, drones, 100) for drones in (20, 40, 60)]
    runs[2]["shares"] = dict.fromkeys(ROLES, 0.0)
    assert all(part >= 0 for cost in costs(runs).values() for part in vars(cost).values())


def test_what_a_thousand_drones_need_follows_from_the_costs() -> None:
    found = needs(1000, OF, (200.0, 100.0, 100.0))
    assert (found.fogs, found.brokers, found.stations) == (4, 1, 1)
    assert found.cores["activators"] == pytest.approx(4 * 9e-3 + 1000 * 1e-4 + 100 * 3e-4)
    assert found.bytes_s == (200_000, 100_000, 100_000)
    assert needs(10_000, OF, ()).stations == 8  # 3.74 cores, half of one each


def test_bytes_of_a_drone_are_those_of_the_page_of_performance() -> None:
    assert hops("| MQTT-XT, bundles | 2,516 | 1,200, 600, 660 | **0.45** |\n") == (200, 100, 110)


def test_money_is_cores_half_idle_and_bytes_out_at_their_prices() -> None:
    prices = {"core": {"dollars": 10.0}, "gigabyte": {"dollars": 0.5}}
    found = scale.needs_table([needs(1000, OF, (200.0, 100.0, 100.0))], prices)
    rows = dict(line.strip("| ").split(" | ") for line in found.splitlines() if line.startswith("| "))
    cores = sum(cost.cores(4, 1000, 100) for cost in OF.values())
    assert rows["cores, half idle, $ a month"] == f"{10 * cores / 0.5:,.0f}"
    assert rows["bytes out of the cloud, $ a month"] == "130"  # 100 kB/s for 30 days are 259.2 GB
    assert rows["both, $ a month and drone"] == f"{(10 * cores / 0.5 + 129.6) / 1000:.2f}"
