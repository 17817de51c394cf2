"""`testbed links` over simulated links: what is printed, what is saved, and what the exit code says."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from testbed.errors import ContainerDied, TestbedError, UserError
from testbed.fly.calibration.table import BEGIN, END, HEAD, document_rows, markdown, rows_of, write_into
from testbed.fly.link_check import check_profiles
from testbed.plan.fleets import standard_fleet
from testbed.plan.profiles.reading import read_profile
from testbed.plan.profiles.resolve import LinksPlan, resolve
from tests.handmade.simulated_links import SimulatedNodes, changed

TOPOLOGY = standard_fleet().topology()
SIK = resolve(read_profile("sik"), TOPOLOGY, "links", 1)


class SimulatedNetwork:
    """Containers whose links are really as `really` makes them of a plan."""

    def __init__(self, really: Callable[[LinksPlan], LinksPlan] = lambda plan: plan, void: str | None = None) -> None:
        self.did: list[Any] = []
        self._really, self._void = really, void
        self._folder = Path()
        self._nodes: SimulatedNodes | None = None

    def __call__(self, profile: str, run_dir: Path, settings: dict[str, str], fleet: Any) -> Any:
        self._folder = run_dir / "links"
        name = json.loads((self._folder / "plan.json").read_text())["plan"]["profile"]
        plan = resolve(read_profile(name), TOPOLOGY, "links", 1)
        self._nodes = SimulatedNodes(self._really(LinksPlan(plan.profile, plan.seed, plan.links, ())), TOPOLOGY)
        return self

    def start(self, *services: str) -> None:
        self.did.append(services)
        (self._folder / "shaper.json").write_text(json.dumps({"shaper": "nfqueue", "why": "the plan asks for it"}))

    def output(self, node: str, command: list[str]) -> str:
        assert self._nodes is not None
        return self._nodes.run(node, command)

    def stop(self, service: str) -> None:
        assert self._nodes is not None
        self.did.append(f"stop {service}")
        links = {name: asdict(link.counters) for name, link in self._nodes.network.links.items()}
        (self._folder / "counters.json").write_text(json.dumps({"version": 1, "links": links, "void": self._void}))

    def down(self) -> None:
        self.did.append("down")


def checked(folder: Path, network: Any, names: str = "sik") -> tuple[bool, str, dict[str, Any]]:
    """Whether all holds, what is printed, what is saved."""
    said = io.StringIO()
    holds = check_profiles(names, "auto", standard_fleet(), folder, Console(file=said, width=120), network)
    return holds, said.getvalue(), json.loads((folder / "links" / "latest" / "links.json").read_text())


@pytest.mark.long
def test_right_links_are_told_configured_beside_measured_and_all_is_taken_down(tmp_path: Path) -> None:
    network = SimulatedNetwork()
    holds, said, saved = checked(tmp_path, network, "ideal,sik")
    assert holds
    assert "all within tolerance: " in said
    assert saved["profiles"]["sik"]["off"] == []
    loss = saved["profiles"]["sik"]["links"]["air:uav1:up"]["loss"]
    assert loss["configured"] == 0.01
    assert loss["frames"] > 800
    nodes = {node.name for node in TOPOLOGY.nodes}
    assert [each if isinstance(each, str) else set(each) for each in network.did[:4]] == [
        "down", {"net", *nodes}, "stop net", "down",
    ]  # fmt: skip
    assert not (tmp_path / "links" / "latest" / "sik" / "pcap").exists(), "only what is of use is kept"


@pytest.mark.long
def test_a_wrong_delay_and_a_wrong_loss_are_each_told_in_a_line(tmp_path: Path) -> None:
    network = SimulatedNetwork(lambda plan: changed(plan, "air:uav3:up", loss=0.05, delay_us=150_000))
    holds, said, saved = checked(tmp_path, network)
    assert not holds
    assert len(saved["profiles"]["sik"]["off"]) == 2
    assert "sik: air:uav3:up delay: configured 40 ms, measured 1" in said
    assert "sik: air:uav3:up loss: configured 1 %, measured " in said
    assert "2 off: " in said


def test_a_shaper_that_did_not_keep_up_is_off(tmp_path: Path) -> None:
    holds, said, _ = checked(tmp_path, SimulatedNetwork(void="the emulator did not keep up: 30 ms late"), "ideal")
    assert not holds
    assert "ideal: the emulator did not keep up: 30 ms late\n1 off: " in said


def test_an_unknown_shaper_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="SHAPER=tc: expected one of auto, netem, nfqueue"):
        check_profiles("ideal", "tc", standard_fleet(), tmp_path, Console(), SimulatedNetwork())
    assert list(tmp_path.iterdir()) == []


def test_a_network_that_ends_says_why_and_is_taken_down(tmp_path: Path) -> None:
    class Dead(SimulatedNetwork):
        def start(self, *services: str) -> None:
            raise ContainerDied("net ended with exit code 1")

        def last_words(self, service: str) -> str:
            return "net: neither netem nor NFQUEUE"

    network = Dead()
    with pytest.raises(TestbedError, match="the links cannot be shaped: net: neither netem nor NFQUEUE"):
        check_profiles("sik", "auto", standard_fleet(), tmp_path, Console(file=io.StringIO()), network)
    assert network.did[-1] == "down"


def test_a_profile_that_there_is_not_is_said_before_anything_starts(tmp_path: Path) -> None:
    network = SimulatedNetwork()
    with pytest.raises(UserError, match="wlan"):
        check_profiles("sik,wlan", "auto", standard_fleet(), tmp_path, Console(file=io.StringIO()), network)
    assert network.did == []
    assert list(tmp_path.iterdir()) == []


def test_a_row_shows_the_link_that_is_furthest_off() -> None:
    def figures(delay_ms: float, lost: int) -> dict[str, Any]:
        unlimited = {"configured": None, "measured": None, "note": "unlimited"}
        return {
            "delay_ms": {"configured": 40.0, "measured": delay_ms, "lowest": 39.0, "highest": 43.0},
            "jitter_ms": {"configured": 0.0, "measured": 0.5, "lowest": 0.0, "highest": 2.0},
            "rate_bps": unlimited,
            "loss": {
                **{"configured": 0.01, "measured": lost / 1000, "lost": lost, "frames": 1000},
                **{"lowest": 1, "highest": 24, "note": None},
            },
        }

    links = {"air:uav1:up": figures(40.9, 12), "air:uav2:up": figures(42.8, 11), "air:uav3:up": figures(39.5, 20)}
    (row,) = rows_of("own", links)
    assert row == ("own", "air up", "40.0 → 42.8", "0.0 → 0.5", "-", "1% → 2%")


def test_what_did_not_arrive_is_not_left_blank() -> None:
    silent = {"configured": 40.0, "measured": None, "lowest": 39.0, "highest": 43.0}
    unprobed = {"configured": None, "measured": None, "note": "unlimited"}
    links = {"air:uav1:up": {"delay_ms": silent, "jitter_ms": silent, "rate_bps": unprobed, "loss": unprobed}}
    assert next(rows_of("own", links))[2:] == ("nothing", "nothing", "-", "-")


def test_the_table_of_a_saved_check_goes_between_a_pages_markers(tmp_path: Path) -> None:
    _, _, saved = checked(tmp_path, SimulatedNetwork(), "ideal")
    page = tmp_path / "page.md"
    for old in ("", "old\n"):
        page.write_text(f"before\n{BEGIN}\n{old}{END}\n<!-- measured: others -->\nkept\n{END}\n")
        write_into(page, markdown(document_rows(saved)))
        lines = page.read_text().splitlines()
        assert lines[:4] == ["before", BEGIN, f"| {' | '.join(HEAD)} |", "|" + " --- |" * len(HEAD)]
        assert lines[-4:] == [END, "<!-- measured: others -->", "kept", END]
    assert "| ideal | air up | 0.0 → " in page.read_text()
    page.write_text("no markers")
    with pytest.raises(ValueError, match="expected <!-- measured: links -->"):
        write_into(page, "")
