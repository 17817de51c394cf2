"""RabbitMQ's users and what they may do, against Mosquitto's list, topic by topic."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from mqttxt import ConfigurationError
from mqttxt.cli.main import app
from mqttxt.protocol.topics import CloudSide
from mqttxt.security import rabbitmq
from mqttxt.security.access_list import entries_of_all
from mqttxt.security.authority import Authority
from mqttxt.security.broker import BrokerFiles
from mqttxt.security.rights import Rights

PORT = 8883


@pytest.fixture
def broker(tmp_path: Path) -> BrokerFiles:
    acme = Authority.create(tmp_path / "acme", "acme")
    for name in ("broker-cloud", "fog1", "fog2", "drone1"):
        acme.issue(name)
    acme.issue("gs-ops", Rights(frozenset({1})))
    acme.issue("gs-view", Rights(observe=True))
    acme.issue("gs-gone", Rights(None))
    acme.revoke("gs-gone")
    return BrokerFiles(acme.folder / "broker-cloud", "acme.x/")


def as_rabbitmq(topic: str) -> str:
    """How RabbitMQ names a topic or a filter."""
    return topic.translate(str.maketrans("/.+", "./*"))


def may(found: dict[str, Any], user: str, what: str, topic: str) -> bool:
    (given,) = [each for each in found["topic_permissions"] if each["user"] == user]
    return re.search(given[what], as_rabbitmq(topic)) is not None


def test_only_members_with_rights_at_the_cloud_are_users(broker: BrokerFiles) -> None:
    found = rabbitmq.definitions(broker, PORT)
    assert [user["name"] for user in found["users"]] == ["fog1", "fog2", "gs-ops", "gs-view"]
    assert {user["password_hash"] for user in found["users"]} == {""}


@pytest.mark.long
def test_who_may_publish_what_is_as_mosquittos_list_has_it(broker: BrokerFiles) -> None:
    found = rabbitmq.definitions(broker, PORT)
    for node, entries in entries_of_all(broker.place, broker.members()):
        for entry in entries:
            topic = entry.filter.replace("+", "some")
            assert may(found, str(node), "write", topic) >= entry.publish, (node, entry)
            assert may(found, str(node), "read", topic) >= entry.hear, (node, entry)
    for user, what, topic in (
        *(("gs-ops", "write", f"acme.x/fog1/{rest}") for rest in ("drone2/commands", "reachable", "drone1/clock")),
        *(("gs-view", "write", f"acme.x/fog1/{rest}") for rest in ("drone1/commands", "commands", "drone1/control")),
        *(("fog1", "write", f"acme.x/fog2/{rest}") for rest in ("reachable", "drone1/commands_result/arm")),
        *(("gs-view", "read", f"acme.x/{rest}") for rest in ("#", "+/#", "fog1/#", "fog1/+/#", "fog1/+/commands")),
        *(("fog1", "read", topic) for topic in ("#", "acme.x/fog2/commands", "fog1/commands", "acme.x/fog1/#")),
        *(("fog1", "write", topic) for topic in ("fog1/clock", "acme_x/fog1/clock", "acme.x/fog1/clock/more")),
    ):
        assert not may(found, user, what, topic), (user, what, topic)


def test_what_roles_subscribe_to_is_theirs(broker: BrokerFiles) -> None:
    found, fog = rabbitmq.definitions(broker, PORT), CloudSide(1, "acme.x/")
    for signed in (False, True):
        for topic in (*fog.activator_command_filters(), *fog.activator_filters(signed), fog.clock, fog.revoked):
            assert may(found, "fog1", "read", topic), topic
        for topic in (*fog.station_filters(signed), fog.revoked):
            assert may(found, "gs-view", "read", topic), topic


def another(folder: Path, name: str, *members: str) -> BrokerFiles:
    """The cloud's broker of another fleet, with a fog 1 as the first one has."""
    fleet = Authority.create(folder, name)
    for member in ("broker-cloud", "fog1", *members):
        fleet.issue(member)
    return BrokerFiles(fleet.folder / "broker-cloud", "acme.x/")


def given(out: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((out / "definitions.json").read_text())
    return found


def test_a_user_has_rights_only_in_the_fleets_that_have_such_a_member(broker: BrokerFiles, tmp_path: Path) -> None:
    out = tmp_path / "out"
    rabbitmq.write(broker, out, 8883)
    rabbitmq.write(another(tmp_path / "north", "north", "fog7"), out, 8884)
    found = given(out)
    (ports,) = found["global_parameters"]
    assert ports == {"name": "mqtt_port_to_vhost_mapping", "value": {"8883": "acme", "8884": "north"}}
    assert [each["name"] for each in found["vhosts"]] == ["acme", "north"]
    assert [each["name"] for each in found["users"]] == ["fog1", "fog2", "gs-ops", "gs-view", "fog7"]
    for kind in ("permissions", "topic_permissions"):
        hosts = {(each["user"], each["vhost"]) for each in found[kind]}
        expected = {(name, "acme") for name in ("fog1", "fog2", "gs-ops", "gs-view")}
        assert hosts == expected | {("fog1", "north"), ("fog7", "north")}


def test_who_is_issued_or_revoked_in_one_fleet_changes_no_other(broker: BrokerFiles, tmp_path: Path) -> None:
    out = tmp_path / "out"
    rabbitmq.write(broker, out, 8883)
    rabbitmq.write(another(tmp_path / "north", "north"), out, 8884)
    before = given(out)
    acme = Authority.load(tmp_path / "acme")
    acme.revoke("gs-ops")
    acme.issue("gs-new", Rights(None))
    rabbitmq.write(BrokerFiles(broker.identity.folder, "acme.x/"), out, 8883)
    after = given(out)
    for kind in ("permissions", "topic_permissions"):
        north = [[each for each in found[kind] if each["vhost"] == "north"] for found in (before, after)]
        assert north[0] == north[1] != []
    users = {each["user"] for each in after["permissions"] if each["vhost"] == "acme"}
    assert users == {"fog1", "fog2", "gs-new", "gs-view"}


def test_a_listener_has_its_own_fleets_certificate_and_authority(broker: BrokerFiles, tmp_path: Path) -> None:
    rabbitmq.write(broker, tmp_path / "out", 8883)
    for name in ("fleet.pem", "certificate.pem", "identity.pem"):
        copied, own = tmp_path / "out" / "fleets" / "acme" / name, broker.identity.folder / name
        assert (copied.read_bytes(), copied.stat().st_mode) == (own.read_bytes(), own.stat().st_mode)


def test_a_fleet_whose_folder_was_deleted_is_left_out(broker: BrokerFiles, tmp_path: Path) -> None:
    out = tmp_path / "out"
    rabbitmq.write(broker, out, 8883)
    shutil.rmtree(out / "fleets" / "acme")
    rabbitmq.write(another(tmp_path / "north", "north"), out, 8883)
    assert [each["name"] for each in given(out)["vhosts"]] == ["north"]
    assert [each["name"] for each in given(out)["users"]] == ["fog1"]


def test_fleets_of_one_port_or_one_name_are_refused_and_nothing_is_written(broker: BrokerFiles, tmp_path: Path) -> None:
    out = tmp_path / "out"
    rabbitmq.write(broker, out, 8883)
    before = given(out)
    same_port, same_name = another(tmp_path / "north", "north"), another(tmp_path / "false", "acme")
    with pytest.raises(ConfigurationError, match=r"--listen: fleets acme and north at port 8883; expected one$"):
        rabbitmq.write(same_port, out, 8883)
    with pytest.raises(ConfigurationError, match=r"acme.fleet\.pem: another authority of that name; expected"):
        rabbitmq.write(same_name, out, 8884)
    assert given(out) == before
    assert [path.name for path in (out / "fleets").glob("*/identity.pem")] == ["identity.pem"]


def test_a_fleets_name_is_no_path(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"fleet name '\.\.': expected .*, and more than dots"):
        rabbitmq.write(another(tmp_path / "up", ".."), tmp_path / "out", 8883)
    assert not (tmp_path / "definitions.json").exists()


def test_a_part_that_cannot_be_read_is_named(broker: BrokerFiles, tmp_path: Path) -> None:
    part = rabbitmq.write(broker, tmp_path / "out", 8883).parent / "fleets" / "acme" / "definitions.json"
    part.write_text("{")
    with pytest.raises(ConfigurationError, match=rf"{part}: .*; expected what `mqttxt broker` wrote"):
        rabbitmq.write(another(tmp_path / "north", "north"), tmp_path / "out", 8884)


def test_the_command_writes_definitions_for_the_cloud_alone(broker: BrokerFiles, tmp_path: Path) -> None:
    words = ["broker", "cloud", "--server", "rabbitmq", "--out", str(tmp_path / "out")]
    identity = ["--identity", str(broker.identity.folder)]
    result = CliRunner().invoke(app, [*words, *identity, "--listen", "0.0.0.0:8890"])
    assert (result.exit_code, result.stdout.strip()) == (0, str(tmp_path / "out" / "definitions.json"))
    assert given(tmp_path / "out")["global_parameters"][0]["value"] == {"8890": "acme"}
    for more, said in (
        (["--fogs", "1"], "--fogs: RabbitMQ is no fog's broker; expected none"),
        (
            ["--listen", "10.0.0.1:8883"],
            "--listen '10.0.0.1:8883': RabbitMQ listens at every address; expected 0.0.0.0:PORT",
        ),
    ):
        refused = CliRunner().invoke(app, [*words, *identity, *more])
        assert (refused.exit_code, refused.stderr) == (2, f"mqttxt: {said}\n")
