"""What a person typed, checked: one line that names the option, its value and what was expected."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from testbed.errors import UserError
from testbed.fly.flights import by_hand, mission_command, profile_of, remove_sockets, settings_of
from testbed.fly.links import plan_links
from testbed.plan.compose import COMPOSE_FILE
from testbed.plan.documents import ROOT
from testbed.plan.experiments import ARMS, Plan, make_plan, one_protocol
from testbed.plan.factors import FACTORS, Factors
from testbed.plan.fleets import fleet_of
from testbed.plan.identities import making
from testbed.plan.profiles.reading import profile_names

PROFILES = ", ".join(profile_names())
GOOD = {"experiment": "scenario-1", "attempts": "2", "arm": "thesis", "profile": "ideal", "protocols": "mqttxt"}


def _plan(arm: str = "thesis", **factors: str) -> Plan:
    return make_plan("scenario-1", arm=arm, overrides=factors)


def test_without_a_word_both_protocols_fly_the_thesis_once() -> None:
    plan = make_plan("scenario-1")
    assert (plan.attempts, plan.protocols, plan.label) == (1, ("mqttxt", "mavlink"), "thesis")
    assert plan.factors == Factors("px4-onboard", "one-by-one", 0, "per-uav", "on-change")


def test_every_arm_uses_values_that_one_could_type() -> None:
    for arm in ARMS.values():
        assert all(str(getattr(arm.factors, name)) in values for name, values in FACTORS.items())


@pytest.mark.parametrize(
    ("arm", "factors", "label"),
    [
        ("thesis", {"streams": "px4-gcs"}, "thesis+streams-px4-gcs"),
        ("thesis", {"qos": "1", "states": "", "chain": "shared"}, "thesis+qos-1+chain-shared"),
        ("thesis", {"qos": "0", "streams": "px4-onboard"}, "thesis"),
        ("direct", {"qos": "0"}, "direct+qos-0"),
        ("thesis", {"security": "signed"}, "thesis+security-signed"),
    ],
)
def test_a_factor_by_itself_is_named_where_it_deviates_from_the_arm(
    arm: str, factors: dict[str, str], label: str
) -> None:
    assert _plan(arm, **factors).label == label


def test_a_factor_by_itself_leaves_the_others_as_the_arm_has_them() -> None:
    assert _plan("five-states", chain="direct").factors == Factors("five-states", "concurrent", 1, "direct", "fixed")


def test_the_page_about_experiments_has_every_arm_as_it_is() -> None:
    rows = [line for line in (ROOT / "docs" / "experiments.md").read_text().splitlines() if line.startswith("| `")]
    cells = [[cell.strip(" `") for cell in row.split("|")[1:-1]] for row in rows]
    told = {row[0]: row[1 : 1 + len(FACTORS)] for row in cells if row[0] in ARMS}
    assert told == {arm.name: [str(getattr(arm.factors, name)) for name in FACTORS] for arm in ARMS.values()}


def test_who_flies_first_alternates() -> None:
    plan = make_plan("scenario-1", "3")
    assert [plan.order(number)[0] for number in (1, 2, 3)] == ["mqttxt", "mavlink", "mqttxt"]


def test_compose_gets_every_factor_that_a_container_needs() -> None:
    assert settings_of(_plan(), "mqttxt") == {
        **{
            "QOS": "0",
            "STREAMS": "px4-onboard",
            "CHAIN": "per-uav",
            "TCP_TIMESTAMPS": "1",
            "ENCODING_FLAG": "",
            "BUNDLES_FLAG": "",
        },
        "ALL_STATES_FLAG": "",
    }
    assert settings_of(_plan(tcp="lean"), "mqttxt")["TCP_TIMESTAMPS"] == "0"
    by_air = settings_of(_plan(air="sn"), "mqttxt")
    assert (by_air["AIR_SCHEME"], by_air["AIR_PORT"], by_air["AIR_FLAG"]) == (
        *("mqtt-sn", "1883", "--air-sn 0.0.0.0:1883"),
    )
    assert "AIR_FLAG" not in settings_of(_plan(air="sn"), "mavlink")
    assert settings_of(_plan(air="sn", security="signed"), "mqttxt")["AIR_PORT"] == "1883"
    assert settings_of(_plan(), "mqttxt", "json")["ENCODING_FLAG"] == "--json"
    assert settings_of(_plan("five-states-bundled"), "mqttxt")["BUNDLES_FLAG"] == "--bundles"


def test_in_the_arm_gateway_mavsdk_flies_both_sides() -> None:
    plan = _plan("gateway", security="signed")
    assert settings_of(plan, "mqttxt")["ALL_STATES_FLAG"] == "--all-states"
    assert settings_of(plan, "mavlink")["ALL_STATES_FLAG"] == ""
    words = " ".join(mission_command(plan, "mqttxt"))
    assert words.endswith(" --signed --qos 1 --states on-change --gateway --commanding concurrent")
    assert "--gateway" not in mission_command(plan, "mavlink")
    assert "--gateway" not in mission_command(_plan(), "mqttxt")


@pytest.mark.parametrize("experiment", ["scenario-4", "messages"])
def test_what_mavsdk_cannot_fly_over_the_gateway_is_refused(experiment: str) -> None:
    with pytest.raises(UserError, match=f"STATION=mavsdk: expected another experiment than {experiment}"):
        make_plan(experiment, arm="gateway")


def test_autopilots_talk_to_the_ground_station_themselves_where_no_router_runs() -> None:
    direct = settings_of(_plan("direct"), "mavlink")
    assert (direct["AUTOPILOT_ON"], direct["AUTOPILOT_TO"]) == ("0.0.0.0", "198.18.0.3")
    assert "AUTOPILOT_TO" not in settings_of(_plan("direct"), "mqttxt")
    assert "AUTOPILOT_TO" not in settings_of(_plan("thesis"), "mavlink")


def test_compose_takes_every_setting() -> None:
    text = COMPOSE_FILE.read_text()
    with_sensors = make_plan("scenario-4", overrides={"security": "signed"})
    for settings in (settings_of(_plan("direct"), "mavlink"), settings_of(with_sensors, "mqttxt")):
        taken = [name for name in settings if f"${{{name}:-" not in text]
        assert taken in ([], ["SENSOR_PROFILES"])  # that one is the run's own


def test_a_secured_fleet_has_an_identity_at_every_node_and_mavlink_has_none() -> None:
    tls, signed = (settings_of(_plan(security=value), "mqttxt") for value in ("tls", "signed"))
    assert (tls["MQTT"], tls["MQTT_PORT"], tls["TLS_KEYS"]) == ("mqtts", "8883", "/run-dir/tls/keys.log")
    assert (tls["SIGNED"], signed["SIGNED"], tls["INSECURE"]) == ("0", "1", "0")
    assert tls["UAV4_AS"] == "--identity /run/fleet/testbed/drone4"
    assert signed["UAV4_AS"] == "--identity /run/fleet/testbed/drone4 --signed --fog 2"
    assert signed["FOG2_AS"] == "--identity /run/fleet/testbed/fog2 --signed"
    assert " ".join(mission_command(_plan(security="signed"), "mqttxt")) == (
        "mission fly scenario-1 --protocol mqttxt --fleet 1:1,2,3;2:4,5,6 --events /run-dir/events.jsonl "
        "--links-start /run-dir/links/start --cloud mqtts://198.18.1.3:8883 "
        "--identity /run/fleet/testbed/gs-ops --signed --qos 0 --states on-change"
    )
    assert settings_of(_plan(security="signed"), "mavlink") == settings_of(_plan(), "mavlink")
    assert mission_command(_plan(security="signed"), "mavlink") == mission_command(_plan(), "mavlink")
    assert "-p 8883 --cafile" in by_hand(_plan(security="tls"), "mqttxt", str)
    assert "-p 8883" not in by_hand(_plan(), "mqttxt", str)


def test_sensors_of_a_secured_fleet_have_identities_and_their_drones_brokers() -> None:
    plan = make_plan("scenario-4", overrides={"security": "signed"})
    settings = settings_of(plan, "mqttxt")
    assert settings["SENSOR2_AS"] == "--identity /run/fleet/testbed/sensor2"
    assert settings["SENSORS_FLAG"].startswith("--sensors 0.0.0.0:8883 ")
    issued = [" ".join(command) for command in making(plan.fleet, sensors=True)]
    assert any("issue broker drone6 --address 198.18.26.3 " in said for said in issued)
    assert any("issue sensor 1,2,3,4,5,6 " in said for said in issued)
    assert not any("sensor" in " ".join(command) for command in making(plan.fleet, sensors=False))


def test_the_mission_is_told_how_mqttxt_talks() -> None:
    assert " ".join(mission_command(_plan("five-states"), "mqttxt")) == (
        "mission fly scenario-1 --protocol mqttxt --fleet 1:1,2,3;2:4,5,6 --events /run-dir/events.jsonl "
        "--links-start /run-dir/links/start --cloud mqtt://198.18.1.3:1883 --qos 1 --states fixed"
    )


def test_the_mission_is_told_how_mavlink_talks() -> None:
    assert " ".join(mission_command(_plan("five-states"), "mavlink")) == (
        "mission fly scenario-1 --protocol mavlink --fleet 1:1,2,3;2:4,5,6 --events /run-dir/events.jsonl "
        "--links-start /run-dir/links/start --mavlink udpin://127.0.0.1:14540 "
        "--streams five-states --commanding concurrent"
    )


def test_another_fleet_is_flown_with_its_own_file_and_fogs() -> None:
    plan = make_plan("scenario-4", fleet=fleet_of({"FOGS": "3", "DRONES": "9"}))
    settings = settings_of(plan, "mavlink")
    assert settings["FLEET_FILE"] == "/run-dir/fleet.yaml"
    assert "sensor9=198.19.25.2,198.19.25.3" in settings["SENSOR_NODES"].split()
    command = mission_command(plan, "mavlink")
    assert command[command.index("--fleet") + 1] == "1:1,2,3;2:4,5,6;3:7,8,9"
    assert command[command.index("--mavlink") + 1].endswith("udpin://127.0.0.1:14549")
    assert "9 drones up" in by_hand(plan, "mqttxt", str)
    assert "watch --fog 1 --fog 2 --fog 3" in by_hand(plan, "mqttxt", str)


@pytest.mark.parametrize(("chain", "host"), [("per-uav", "127.0.0.1"), ("direct", "0.0.0.0")])
def test_mavsdk_listens_on_a_port_for_each_drone_unless_they_share_a_chain(chain: str, host: str) -> None:
    command = mission_command(_plan(chain=chain), "mavlink")
    urls = command[command.index("--mavlink") + 1].split(",")
    assert urls == [f"udpin://{host}:{port}" for port in range(14541, 14547)]


def test_what_to_type_by_hand_is_for_the_protocol_that_is_up() -> None:
    name_of = "testbed_{}_1".format
    assert "docker exec -it testbed_gs_1 mqttxt gs watch --fog 1 --fog 2" in by_hand(_plan(), "mqttxt", name_of)
    for command in ("arm", "takeoff 10"):
        assert f"gs send {command} --fog 1 --drone 1 --take-over" in by_hand(_plan(), "mqttxt", name_of), (
            "the page has it"
        )
    mavlink = by_hand(_plan(chain="shared"), "mavlink", name_of)
    assert "--fleet '1:1,2,3;2:4,5,6' --events /tmp/events.jsonl --mavlink udpin://127.0.0.1:14540" in mavlink
    assert "mqttxt" not in mavlink


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"samples": "0"}, "SAMPLES=0: expected a whole number from 1 to 600"),
        ({"samples": "many"}, "SAMPLES=many: expected a whole number from 1 to 600"),
        (
            {"experiment": "scenario-9"},
            "experiment=scenario-9: expected one of "
            "scenario-1, scenario-2, scenario-3, scenario-4, scenario-5, messages",
        ),
        *(
            ({"experiment": "messages", "count": text}, f"COUNT={text}: expected a whole number from 1 to 1000")
            for text in ("0", "1001", "-1", "1.5", "ten", "٣", "")
        ),
        ({"attempts": "0"}, "ATTEMPTS=0: expected a whole number from 1 to 99"),
        ({"attempts": "x"}, "ATTEMPTS=x: expected a whole number from 1 to 99"),
        ({"attempts": "٣"}, "ATTEMPTS=٣: expected a whole number from 1 to 99"),
        ({"attempts": "9" * 5000}, f"ATTEMPTS={'9' * 40}: expected a whole number from 1 to 99"),
        ({"samples": "601"}, "SAMPLES=601: expected a whole number from 1 to 600"),
        ({"attempts": ""}, "ATTEMPTS=: expected a whole number from 1 to 99"),
        (
            {"arm": "fast"},
            "ARM=fast: expected one of thesis, thesis-concurrent, five-states, five-states-bundled, gateway, direct",
        ),
        ({"profile": "wifi"}, f"PROFILE=wifi: expected one of {PROFILES}, or the path of a .yaml file"),
        ({"protocols": "mqttxt,carrier-pigeon"}, "PROTOCOLS=carrier-pigeon: expected one of mqttxt, mavlink"),
        ({"protocols": "mavlink,"}, "PROTOCOLS=: expected one of mqttxt, mavlink"),
        ({"overrides": {"streams": "all"}}, "STREAMS=all: expected one of px4-onboard, px4-gcs, five-states"),
        ({"overrides": {"commanding": "both"}}, "COMMANDING=both: expected one of one-by-one, concurrent"),
        ({"overrides": {"qos": "2"}}, "QOS=2: expected one of 0, 1"),
        ({"overrides": {"qos": "٠"}}, "QOS=٠: expected one of 0, 1"),
        ({"overrides": {"chain": "long"}}, "CHAIN=long: expected one of per-uav, shared, direct"),
        ({"overrides": {"states": "often"}}, "STATES=often: expected one of on-change, fixed, bundle"),
    ],
)
def test_a_mistake_is_named(changed: dict[str, Any], said: str) -> None:
    with pytest.raises(UserError) as mistake:
        make_plan(**{**GOOD, **changed})
    assert str(mistake.value) == said
    assert mistake.value.exit_code == 2


def test_one_fleet_can_be_up_at_a_time() -> None:
    assert one_protocol("mavlink") == "mavlink"
    with pytest.raises(UserError, match=r"PROTOCOLS=mqttxt,mavlink: expected mqttxt or mavlink, one of them"):
        one_protocol("mqttxt,mavlink")


@pytest.mark.parametrize("protocol", ["mqttxt", "mavlink"])
def test_sensors_are_told_of_only_where_they_are_flown_to(protocol: str) -> None:
    without, flown = make_plan("scenario-2", samples="7"), make_plan("scenario-4", samples="7")
    assert "SAMPLES" not in settings_of(without, protocol)
    assert settings_of(flown, protocol)["SAMPLES"] == "7"
    assert "--samples" not in mission_command(without, protocol)
    words = mission_command(flown, protocol)
    assert words[words.index("--samples") + 1] == "7"


@pytest.mark.parametrize("size", [{}, {"FOGS": "3", "DRONES": "9"}], ids=["the experiments' fleet", "another fleet"])
def test_the_message_set_is_flown_by_one_drone_whose_autopilot_can_be_put_back(size: dict[str, str]) -> None:
    plan = make_plan("messages", count="7", fleet=fleet_of(size))
    assert profile_of(plan, "mavlink") == "mavlink-one"
    settings = settings_of(plan, "mavlink")
    assert (settings["ONLY_FLAG"], settings["CONTROL_DIR"]) == ("--only 1", "/run-dir/sitl")
    for protocol in ("mqttxt", "mavlink"):
        words = mission_command(plan, protocol)
        named = {word: after for word, after in pairwise(words) if word.startswith("--")}
        assert named["--fleet"] == "1:1"
        assert named["--count"] == "7"
        assert named["--control"] == "/run-dir/sitl/uav1.sock"
    assert named["--mavlink"] == "udpin://127.0.0.1:14541"


def test_a_scenario_knows_nothing_of_the_message_set() -> None:
    plan = make_plan("scenario-1", count="7")
    assert profile_of(plan, "mavlink") == "mavlink"
    assert not {"ONLY_FLAG", "CONTROL_DIR"} & set(settings_of(plan, "mavlink"))
    assert "--count" not in mission_command(plan, "mqttxt")
    assert plan.limit_s < make_plan("messages", count="1").limit_s


@pytest.mark.parametrize(("experiment", "count"), [("scenario-1", "10"), ("messages", "100")])
def test_links_change_for_as_long_as_a_mission_may_take(experiment: str, count: str) -> None:
    plan = make_plan(experiment, profile="leo", count=count)
    at_s = [event.at_s for event in plan_links(plan, 1).events]
    assert at_s[0] < 60
    assert plan.limit_s - 60 < at_s[-1] < plan.limit_s


def test_control_sockets_that_were_left_are_removed_and_nothing_else(tmp_path: Path) -> None:
    folder = tmp_path / "sitl"
    folder.mkdir()
    for name in ("uav1.sock", "uav1.jsonl"):
        (folder / name).touch()
    remove_sockets(tmp_path)
    assert [path.name for path in folder.iterdir()] == ["uav1.jsonl"]


def test_a_mission_of_ones_own_is_called_after_its_file(tmp_path: Path) -> None:
    mission = tmp_path / "search-2.py"
    mission.write_text("async def mission(fleet, steps): ...\n")
    plan = make_plan(str(mission))
    assert (plan.experiment, plan.mission, plan.has_sensors) == ("search-2", mission, False)
    assert mission_command(plan, "mqttxt")[2] == "/run-dir/search-2.py"


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("none.py", "none.py: expected a Python file with `async def mission(fleet, steps)`"),
        ("My mission.py", "expected a name of lower-case letters, digits, - and _ that no scenario has"),
        ("scenario-1.py", "expected a name of lower-case letters, digits, - and _ that no scenario has"),
        ("links.py", "expected a name of lower-case letters, digits, - and _ that no scenario has, nor links, repro"),
        ("two\nlines.py", "expected a name of lower-case letters, digits, - and _ that no scenario has"),
    ],
)
def test_a_mission_that_is_none_is_named(tmp_path: Path, name: str, said: str) -> None:
    if name != "none.py":
        (tmp_path / name).touch()
    with pytest.raises(UserError) as error:
        make_plan(str(tmp_path / name))
    assert str(error.value).lstrip("'").startswith(repr(str(tmp_path / name)).strip("'"))
    assert said in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("experiment", "factors", "said"),
    [
        ("scenario-1", {"air": "sn", "security": "tls"}, "AIR=sn: expected SECURITY=none or signed"),
        ("messages", {"air": "sn"}, "AIR=sn: expected another experiment than messages"),
        ("scenario-1", {"air": "udp"}, "AIR=udp: expected one of tcp, sn"),
    ],
)
def test_datagrams_are_flown_where_they_can_be(experiment: str, factors: dict[str, str], said: str) -> None:
    with pytest.raises(UserError, match=re.escape(said)):
        make_plan(experiment, overrides=factors)
