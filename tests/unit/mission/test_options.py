"""What a mission is told: each mistake is one line with the option, its value and what was expected; exit code 2."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from mission.__main__ import app
from mission.options import parse_fleet, parse_urls

FORMS = "mqtt://HOST[:PORT] or mqtts://HOST[:PORT], with a port from 1 to 65535"
GOOD = {"--fleet": "1:1,2;2:4", "--cloud": "mqtt://127.0.0.1:1", "--events": "events.jsonl"}


def _said(tmp_path: Path, scenario: str = "scenario-1", **changed: str) -> tuple[int, str]:
    options = {**GOOD, "--events": str(tmp_path / "events.jsonl")}
    options |= {f"--{name}": value for name, value in changed.items()}
    words = [word for pair in options.items() for word in pair]
    done = CliRunner().invoke(app, ["fly", scenario, *words], env={"MQTTXT_CLOUD": ""})
    return done.exit_code, done.stderr


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        (
            {"scenario": "scenario-9"},
            "scenario 'scenario-9': expected one of "
            "scenario-1, scenario-2, scenario-3, scenario-4, scenario-5, messages",
        ),
        ({"protocol": "pigeon"}, "--protocol 'pigeon': expected one of mqttxt, mavlink"),
        ({"qos": "2"}, "--qos '2': expected one of 0, 1"),
        ({"states": "often"}, "--states 'often': expected one of on-change, fixed, bundle"),
        ({"streams": "all"}, "--streams 'all': expected one of px4-onboard, px4-gcs, five-states"),
        ({"commanding": "both"}, "--commanding 'both': expected one of one-by-one, concurrent"),
        ({"cloud": ""}, "--cloud '': expected the cloud broker, mqtt://HOST[:PORT]"),
        ({"cloud": "http://a"}, f"broker 'http://a': expected {FORMS}"),
        ({"protocol": "mavlink"}, "--mavlink '': expected udpin://HOST:PORT, as udpin://0.0.0.0:14540"),
        (
            {"protocol": "mavlink", "mavlink": "udpin://0.0.0.0:14540,14541"},
            "--mavlink '14541': expected udpin://HOST:PORT, as udpin://0.0.0.0:14540",
        ),
        (
            {"protocol": "mavlink", "mavlink": "udpin://0.0.0.0:14541,udpin://0.0.0.0:14542"},
            "--mavlink: 2 connections for 3 drones: expected 1 or 3",
        ),
        ({"samples": "0"}, "--samples 0: expected 1 to 600"),
        ({"samples": "601"}, "--samples 601: expected 1 to 600"),
        (
            {"scenario": "scenario-4"},
            "scenario-4: expected --sensors, the folder of what the sensors write down",
        ),
        (
            {"scenario": "scenario-4", "sensors": "."},
            "scenario-4: expected --series, a file for what arrived of it",
        ),
        (
            {"scenario": "scenario-4", "sensors": ".", "series": "/nowhere/series.json"},
            "--series /nowhere/series.json: expected a folder that can be written to",
        ),
        (
            {
                **{"scenario": "scenario-4", "sensors": ".", "series": "/tmp/not-there-series.json"},
                **{"protocol": "mavlink", "mavlink": "udpin://0.0.0.0:14540"},
            },
            "scenario-4: expected --sensor-broker, where readings arrive: mqtt://HOST[:PORT]",
        ),
        (
            {
                **{"scenario": "scenario-4", "sensors": ".", "series": "/tmp/not-there-series.json"},
                **{"protocol": "mavlink", "mavlink": "udpin://0.0.0.0:14540", "sensor-broker": "here"},
            },
            f"--sensor-broker 'here': expected {FORMS}",
        ),
        ({"scenario": "messages"}, "--fleet: 3 drones: expected one for messages, as 1:1"),
        ({"scenario": "messages", "fleet": "1:1", "count": "0"}, "--count 0: expected 1 to 1000"),
        ({"scenario": "messages", "fleet": "1:1", "count": "1001"}, "--count 1001: expected 1 to 1000"),
        (
            {"scenario": "messages", "fleet": "1:1"},
            "messages: expected --control, the control socket of the autopilot's stand-in",
        ),
        ({"fleet": "1;2"}, "--fleet '1;2': expected FOG:DRONE,DRONE;FOG:DRONE, as 1:1,2,3;2:4,5,6"),
        ({"fleet": "1:1,2;2:2"}, "--fleet '1:1,2;2:2': expected each fog and each drone once"),
        ({"fleet": "1:1;1:2"}, "--fleet '1:1;1:2': expected each fog and each drone once"),
    ],
)
def test_a_mistake_is_named(changed: dict[str, str], said: str, tmp_path: Path) -> None:
    assert _said(tmp_path, **changed) == (2, f"mission: {said}\n")


def test_a_gateway_belongs_to_mqttxt(tmp_path: Path) -> None:
    over = ["--protocol", "mavlink", "--mavlink", "udpin://0.0.0.0:14540", "--gateway"]
    words = ["--fleet", "1:1", "--events", str(tmp_path / "events.jsonl"), *over]
    done = CliRunner().invoke(app, ["fly", "scenario-1", *words])
    said = "mission: --gateway: scenario-1 over mavlink: expected another scenario over mqttxt\n"
    assert (done.exit_code, done.stderr) == (2, said)


def test_a_file_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    code, said = _said(tmp_path, events=str(tmp_path / "none" / "events.jsonl"))
    assert code == 2
    assert "none/events.jsonl" in said
    assert said.count("\n") == 1


def test_a_start_of_the_links_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    there = tmp_path / "start"
    there.touch()
    expected = f"mission: --links-start {there}: expected a file that is not there yet\n"
    assert _said(tmp_path, **{"links-start": str(there)}) == (2, expected)
    nowhere = tmp_path / "none" / "start"
    expected = f"mission: --links-start {nowhere}: expected a folder that can be written to\n"
    assert _said(tmp_path, **{"links-start": str(nowhere)}) == (2, expected)


def test_a_drone_without_a_point_is_named_where_points_are_flown_to(tmp_path: Path) -> None:
    expected = "mission: drone 7 has no point in the fleet's file: expected drones of 1, 2, 3, 4, 5, 6\n"
    assert _said(tmp_path, "scenario-2", fleet="1:1;2:7") == (2, expected)


def test_mavsdk_is_loaded_only_for_the_fleet_that_flies_with_it() -> None:
    program = "import sys, mission.__main__; print('mavsdk' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], capture_output=True, text=True).stdout == "False\n"


def test_a_fleet_is_fogs_and_their_drones() -> None:
    assert parse_fleet("1:1,2,3;2:4") == {1: (1, 2, 3), 2: (4,)}


def test_connections_are_a_list() -> None:
    assert parse_urls("udpin://0.0.0.0:14541, udpout://uav.example:14540") == (
        "udpin://0.0.0.0:14541",
        "udpout://uav.example:14540",
    )
