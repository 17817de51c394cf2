"""Scenario 1 as people type it: flown, captured, measured and reported; and ended well when it goes wrong."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from sitl.px4.streams import RATES_HZ
from tests.e2e.flying import Run, attempt_over, containers, quick_drones

pytestmark = [pytest.mark.e2e, pytest.mark.alone, pytest.mark.timeout(600)]

ENDING_BADLY = pytest.mark.soak("testbed/cli", "testbed/fly", "services/router/src", "compose.yaml")
KILL_ROUTER = """
import os, pathlib, signal
for found in pathlib.Path('/proc').glob('[0-9]*/cmdline'):
    if found.read_bytes().startswith(b'mavp2p\\0udps:198.18.11.3:14541'):
        os.kill(int(found.parent.name), signal.SIGKILL)
        print('killed')
"""


def heard_topics(limit_s: int) -> dict[str, bytes]:
    """What `mosquitto_sub -v -t 'fog1/#'` shows beside a flight."""
    gs = containers()["gs"]
    command = ["mosquitto_sub", "-h", "198.18.1.3", "-t", "fog1/#", "-W", str(limit_s), "-F", "%t %x"]
    output = gs.exec_run(command).output.decode()
    heard = [line.split(" ") for line in output.splitlines() if line.startswith("fog1/")]  # the flight may end before
    return {topic: bytes.fromhex(payload) for topic, payload in heard}


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, dict[str, bytes], dict[str, Any]]:
    """One run over both protocols: the run, what was heard beside the first flight, and the metrics."""
    folder = tmp_path_factory.mktemp("flown")
    run = Run(folder / "results", environment=quick_drones(folder))
    run.says("  arm ")
    topics = heard_topics(limit_s=40)
    assert run.wait() == 0, run.output
    return run, topics, run.metrics()


Flown = tuple[Run, dict[str, bytes], dict[str, Any]]


@pytest.mark.parametrize("protocol", ["mqttxt", "mavlink"])
def test_scenario_1_is_flown_measured_and_reported_over(flown: Flown, protocol: str) -> None:
    run, _, metrics = flown
    (attempt,) = metrics["protocols"][protocol]["attempts"]
    assert attempt["status"] == "completed"
    assert 15 < attempt["mission_s"] < 120, "it holds for 15 s"
    assert {drone: [o["word"] for o in said] for drone, said in attempt["outcomes"].items()} == {
        str(drone): ["completed"] * 3 for drone in range(1, 7)
    }
    assert set(attempt["links"]) == {
        f"{link}:{way}"
        for link in ("wan:gs", "backhaul:fog1", "backhaul:fog2", *(f"air:uav{n}" for n in range(1, 7)))
        for way in ("up", "down")
    }
    assert all(link["packets"] > 0 and link["lost"] == 0 for link in attempt["links"].values())
    assert sum(attempt["layers"].values()) == attempt["size_bytes"]
    assert attempt["message_loss"]["commands"] == 0.0
    assert attempt["truncated"] == []

    flight = attempt_over(run, protocol)
    manifest = flight.manifest()
    assert all(capture["dropped"] == 0 and capture["captured"] > 0 for capture in manifest["captures"])
    assert len(manifest["captures"]) == 10
    assert all(seconds > 0 for service, seconds in manifest["cpu_s"].items() if service.startswith(("sitl", "net")))
    for drone, log in flight.autopilot_events().items():
        happened = [event["event"] for event in log if event["event"] not in ("position", "command", "mode")]
        assert happened == ["armed", "took_off", "landed", "disarmed"], drone


def test_one_report_has_both_sides(flown: Flown) -> None:
    run, _, metrics = flown
    page = (run.latest / "report.html").read_text()
    assert "MQTT-XT" in page
    assert "MAVLink" in page
    assert metrics["ratios"]["packets"] > 50
    assert metrics["ratios"]["size"] > 50
    assert "results" in run.lines[-1]
    assert run.lines[-1].endswith("report.html")


def test_any_mqtt_tool_reads_along(flown: Flown) -> None:
    _, topics, _ = flown
    assert {"fog1/commands", "fog1/commands_result/land", "fog1/clock", "fog1/reachable"} <= set(topics)
    assert b"mqtt://198.18.11.3:1883" in topics["fog1/reachable"]
    for drone in (1, 2, 3):
        assert {f"fog1/drone{drone}/state/location", f"fog1/drone{drone}/commands_result/land"} <= set(topics)


def test_the_autopilots_stream_what_px4_does(flown: Flown) -> None:
    """Within 10 % of each stream's rate, or one message a drone for the slow ones."""
    run, _, metrics = flown
    (attempt,) = metrics["protocols"]["mavlink"]["attempts"]
    counts = {stream["name"]: stream["count"] for stream in attempt["mavlink"]["streams"]}
    logs = attempt_over(run, "mavlink").autopilot_events()
    for name, rates_hz in RATES_HZ.items():
        expected = rates_hz[0] * attempt["mission_s"] * len(logs)
        assert counts.get(name, 0) == pytest.approx(expected, rel=0.1, abs=len(logs)), name


def test_on_ideal_links_no_state_is_lost_but_what_a_routers_own_queue_drops_on_a_busy_machine(flown: Flown) -> None:
    _, _, metrics = flown
    (over_mqttxt,), (over_mavlink,) = (metrics["protocols"][name]["attempts"] for name in ("mqttxt", "mavlink"))
    assert over_mqttxt["message_loss"]["states"] == 0.0
    routers = {(router["node"], router["way"]): router for router in over_mavlink["mavlink"]["routers"]}
    assert {(node, way) for node in ("cloud", "fog1", "fog2") for way in ("up", "down")} == set(routers)
    assert all(router["in"] > 0 for router in routers.values())
    dropped = sum(router["dropped"] for router in routers.values())
    lost = over_mavlink["message_loss"]["states"] * over_mavlink["states_sent"]
    assert lost <= dropped <= sum(router["in"] for router in routers.values()) / 200


@ENDING_BADLY
def test_ctrl_c_ends_all_containers_and_keeps_what_was_captured(tmp_path: Path) -> None:
    run = Run(tmp_path / "results")
    run.says("  arm ")
    run.interrupt()
    assert run.wait() == 130
    assert "interrupted; the containers are ended, what was captured is kept" in run.output
    (pcap,) = (tmp_path / "results").glob("scenario-1/thesis-ideal/*/mqttxt/attempt-01/pcap/gs.pcap")
    assert pcap.stat().st_size > 1000
    manifest = json.loads((pcap.parents[1] / "manifest.json").read_text())
    assert (manifest["status"], manifest["reason"]) == ("void", "interrupted")


@ENDING_BADLY
def test_what_dies_in_mid_mission_is_named_with_its_last_words_and_the_rest_of_the_run_is_kept(tmp_path: Path) -> None:
    run = Run(tmp_path / "results")
    run.says("  arm ")
    containers()["client3"].kill()
    run.says("over mavlink")
    run.wait_for(lambda: sum("  arm " in line for line in run.lines) == 2)
    killed = containers()["router-fog1"].exec_run(["python3", "-c", KILL_ROUTER], user="1000:1000")
    assert killed.output == b"killed\n"
    assert run.wait() == 1
    assert "client3 ended with exit code 137; its last log lines:" in run.output
    assert "drone 3: heard its autopilot" in run.output
    assert "router-fog1 ended with exit code 1; its last log lines:" in run.output
    assert "mavp2p udps:198.18.11.3:14541 udpc:198.18.1.3:14541 --hb-systemid=221 ended with code" in run.output
    for protocol, dead in (("mqttxt", "client3"), ("mavlink", "router-fog1")):
        (attempt,) = run.metrics()["protocols"][protocol]["attempts"]
        assert attempt["status"] == "failed"
        assert attempt["reason"].startswith(f"{dead} ended")
        assert attempt["packets"] > 0
        assert f"{dead} ended" in (run.latest / "report.html").read_text()
