"""The live page in the testbed: how links are shown and changed, the page's identity and its process."""

from __future__ import annotations

import json
import os
import signal
import socket
import stat
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from mqttxt.errors import ConfigurationError
from mqttxt.page.links import LinkFigures
from testbed.errors import TestbedError
from testbed.fly import page_process
from testbed.fly.links import write_plan
from testbed.fly.page import PageLinks, copy_identity
from testbed.fly.page_process import PID, end_page, page_port, start_page
from testbed.fly.results import Attempt, live_attempt
from testbed.plan.experiments import make_plan
from testbed.plan.fleets import standard_fleet
from testbed.plan.identities import making
from testbed.plan.profiles.reading import read_profile
from testbed.plan.profiles.resolve import resolve
from tests.rigs.processes import wait_until

FLEET = standard_fleet()


class Net:
    """`net`: what it was told, and what it answers."""

    def __init__(self, folder: Path, profile: str = "lte") -> None:
        self.attempt = live_attempt(folder, "mqttxt")
        links = resolve(read_profile(profile), FLEET.topology(), "scenario-1", 1)
        write_plan(folder / "links", links, FLEET.topology(), "auto", always=True)
        self.told: list[list[str]] = []
        self.answer = '{"ok": true}'

    def ask(self, command: list[str]) -> str:
        if command[0] == "cat":
            return (self.attempt.path / "links" / "plan.json").read_text()
        self.told.append(command[2:-2])
        return self.answer

    def happens(self, link: str, change: dict[str, object] | None, cause: str = "hand") -> None:
        with (self.attempt.path / "links" / "events.jsonl").open("a") as file:
            file.write(json.dumps({"t_ns": 1, "link": link, "change": change, "cause": cause}) + "\n")


@pytest.fixture
def net(tmp_path: Path) -> Net:
    return Net(tmp_path)


@pytest.fixture
def links(net: Net) -> PageLinks:
    return PageLinks("mqttxt", net.attempt.path, FLEET, net.ask)


def shown(links: PageLinks, name: str) -> LinkFigures:
    (found,) = [figures for figures in links.look() if figures.name == name]
    return found


def test_every_direction_has_its_profiles_figures_and_what_stands_over_them(net: Net, links: PageLinks) -> None:
    assert len(links.look()) == 2 * len(FLEET.topology().links)
    planned = shown(links, "air:uav3:up")
    assert planned.rate_bps is not None
    assert not planned.is_changed
    (net.attempt.path / "links" / "events.jsonl").write_text('{"t_ns": 1, "event": "start"}\n')
    net.happens("air:uav3:up", {"closed": True}, "profile")
    assert shown(links, "air:uav3:up") == replace(planned, is_closed=True, is_changed=True)
    net.happens("air:uav3:up", {"loss": 0.2, "delay_us": 12_500})
    assert shown(links, "air:uav3:up") == replace(planned, loss=0.2, delay_ms=12.5, is_changed=True)
    net.happens("air:uav3:up", None)
    net.happens("air:uav3:up", None, "profile")
    assert shown(links, "air:uav3:up") == planned


def test_a_link_is_changed_as_by_hand_and_keeps_what_was_changed_before(net: Net, links: PageLinks) -> None:
    links.change("air:uav3", {"loss": "20%"}, closed=False)
    links.change("air:uav3", {"delay": "300ms"}, closed=True)
    links.change("air:uav3", {}, closed=False)
    ways = ["air:uav3:up", "air:uav3:down"]
    both = ["loss=0.2", "delay_us=300000"]
    assert net.told == [
        *([way, "loss=0.2"] for way in ways),
        *([way, *both, "closed=true"] for way in ways),
        *([way, *both] for way in ways),
    ]
    net.told.clear()
    links.put_back("air:uav3")
    links.change("air:uav3", {"loss": "1%"}, closed=False)
    assert net.told == [*([way] for way in ways), *([way, "loss=0.01"] for way in ways)]


def test_a_rate_has_a_queue_where_its_profile_has_none_and_a_link_that_is_opened_is_back(tmp_path: Path) -> None:
    net = Net(tmp_path, "ideal")
    links = PageLinks("mavlink", tmp_path, FLEET, net.ask)
    links.change("wan:gs", {"rate": "64kbit"}, closed=False)
    assert net.told[0] == ["wan:gs:up", "rate_bps=64000", "queue_packets=100"]
    links.change("wan:gs", {"rate": "unlimited"}, closed=False)
    assert net.told[-1] == ["wan:gs:down", "rate_bps=null", "queue_packets=null"]
    links.change("air:uav1", {}, closed=True)
    links.change("air:uav1", {}, closed=False)
    assert net.told[-4:] == [
        *([f"air:uav1:{way}", "closed=true"] for way in ("up", "down")),
        *([f"air:uav1:{way}"] for way in ("up", "down")),
    ]


def test_what_cannot_be_is_one_line_and_is_not_kept(net: Net, links: PageLinks) -> None:
    with pytest.raises(ConfigurationError, match=r"^link air:uav9: expected one of wan:gs"):
        links.change("air:uav9", {"loss": "20%"}, closed=False)
    with pytest.raises(ConfigurationError, match="--delay"):
        links.change("air:uav1", {"delay": "fast"}, closed=False)
    net.answer = '{"error": "links are not shaped in this run"}'
    with pytest.raises(ConfigurationError, match=r"^air:uav1:up: links are not shaped"):
        links.change("air:uav1", {"loss": "3%"}, closed=False)
    net.answer = '{"ok": true}'
    net.told.clear()
    links.change("air:uav1", {"loss": "4%"}, closed=False)
    assert net.told[0] == ["air:uav1:up", "loss=0.04"]


def test_the_pages_station_has_an_identity_of_its_own_where_there_is_a_page() -> None:
    issued = [" ".join(command) for command in making(FLEET, sensors=False, page=True)]
    (own,) = [command for command in issued if "issue station page" in command]
    assert "--may command --drones *" in own
    assert not any("station page" in " ".join(command) for command in making(FLEET, sensors=False))


def test_the_identity_that_is_copied_is_nobody_elses_to_read(tmp_path: Path) -> None:
    copy_identity(lambda command: f"content of {command[1]}", tmp_path)
    assert len(list(tmp_path.iterdir())) == 4
    for path in tmp_path.iterdir():
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        assert path.read_text() == f"content of /run/fleet/testbed/gs-page/{path.name}"


def test_a_taken_port_is_not_the_pages(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        monkeypatch.setattr(page_process, "PORT", taken.getsockname()[1])
        assert page_port() != taken.getsockname()[1]


def _page_is(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, script: str) -> Attempt:
    """The page's process is this Python program, which is called as the page would be."""
    program = tmp_path / "python"
    program.write_text(f"#!{sys.executable}\nimport sys, time\n{script}\n")
    program.chmod(0o755)
    monkeypatch.setattr(page_process.sys, "executable", str(program))
    return live_attempt(tmp_path / "live", "mqttxt")


def test_the_page_is_started_as_its_plan_says_and_ended_by_another_process(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    attempt = _page_is(
        monkeypatch, tmp_path, "print(sys.argv, 'INFO open http://127.0.0.1:8099/', flush=True)\ntime.sleep(600)"
    )
    plan = replace(make_plan("scenario-1", overrides={"security": "tls"}), page=8099)
    page = start_page(plan, attempt, watch_only=True)
    said = (attempt.path / "logs" / "page.log").read_text()
    for word in ("'page'", "'--protocol', 'mqttxt'", "'--port', '8099'", "'--security', 'tls'", "'--watch-only'"):
        assert word in said
    end_page(attempt.path)
    assert page.wait(20) == -signal.SIGTERM
    assert not (attempt.path / PID).exists()


def test_a_page_that_is_not_served_ends_the_run_with_its_last_words(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    attempt = _page_is(monkeypatch, tmp_path, "print('starting')\nsys.exit('--listen: cannot listen')")
    with pytest.raises(TestbedError, match=r"^the page is not served: --listen: cannot listen$"):
        start_page(replace(make_plan("scenario-1"), page=8099), attempt, watch_only=False)


def test_no_other_process_is_ended_that_has_the_pages_number(tmp_path: Path) -> None:
    with subprocess.Popen(["sleep", "600"]) as other:
        (tmp_path / PID).write_text(str(other.pid))
        end_page(tmp_path)
        os.kill(other.pid, 0)
        other.kill()
    (tmp_path / PID).write_text("none")
    end_page(tmp_path)
    wait_until(lambda: other.poll() is not None, "the other one is ended by its test")
