"""RabbitMQ's users and what they may do, against Mosquitto's list, topic by topic."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from mqttxt.cli.main import app
from mqttxt.protocol.topics import CloudSide
from mqttxt.security import rabbitmq
from mqttxt.security.access_list import entries_of_all
from mqttxt.security.authority import Authority
from mqttxt.security.broker import BrokerFiles
from mqttxt.security.rights import Rights


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
    found = rabbitmq.definitions(broker)
    assert [user["name"] for user in found["users"]] == ["fog1", "fog2", "gs-ops", "gs-view"]
    assert {user["password_hash"] for user in found["users"]} == {""}


@pytest.mark.long
def test_who_may_publish_what_is_as_mosquittos_list_has_it(broker: BrokerFiles) -> None:
    found = rabbitmq.definitions(broker)
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
    found, fog = rabbitmq.definitions(broker), CloudSide(1, "acme.x/")
    for signed in (False, True):
        for topic in (*fog.activator_command_filters(), *fog.activator_filters(signed), fog.clock, fog.revoked):
            assert may(found, "fog1", "read", topic), topic
        for topic in (*fog.station_filters(signed), fog.revoked):
            assert may(found, "gs-view", "read", topic), topic


def test_the_command_writes_definitions_for_the_cloud_alone(broker: BrokerFiles, tmp_path: Path) -> None:
    words = ["broker", "cloud", "--server", "rabbitmq", "--out", str(tmp_path / "out")]
    identity = ["--identity", str(broker.identity.folder)]
    result = CliRunner().invoke(app, [*words, *identity])
    assert (result.exit_code, result.stdout.strip()) == (0, str(tmp_path / "out" / "definitions.json"))
    shared = CliRunner().invoke(app, [*words, *identity, "--fogs", "1"])
    assert (shared.exit_code, shared.stderr) == (2, "mqttxt: --fogs: RabbitMQ is no fog's broker; expected none\n")
