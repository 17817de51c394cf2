"""Which messages are a kind's own: on tables of a few rows made by hand."""

from __future__ import annotations

from typing import Any

import polars as pl
import pytest

from mqttxt.protocol.bundles import drone_bundle, fog_bundles
from mqttxt.protocol.codec import encode
from mqttxt.protocol.messages import FogResultMessage, Word, WordTogether
from mqttxt.protocol.state_payload import StampedState
from mqttxt.protocol.states import Battery, Heading
from testbed.numbers.metrics.message_kinds import own_mavlink, own_mqttxt, setpoints
from testbed.numbers.metrics.ways import Ways
from testbed.numbers.packets.rows import MESSAGE_SCHEMA
from testbed.plan.topology import Link, Node, Topology
from tests.handmade.attempts import LINKS, NODES

WAYS = Ways(Topology(tuple(Node(*node) for node in NODES.items()), tuple(Link(*link) for link in LINKS)))


def table(*rows: dict[str, Any]) -> pl.DataFrame:
    """Messages with the fields that are given, and the column `row`."""
    empty = dict.fromkeys(MESSAGE_SCHEMA.names())
    made = pl.DataFrame([empty | row for row in rows], schema=MESSAGE_SCHEMA)
    return made.with_row_index("row").with_columns(pl.col("row").cast(pl.Int64))


def names(own: pl.DataFrame) -> dict[int, str]:
    return dict(own.select("row", "name").iter_rows())


def long(command: int, target: int = 1, **params: float) -> dict[str, Any]:
    return {"kind": "COMMAND_LONG", "command": command, "target_system": target, "system": 245, **params}


def ack(command: int, system: int = 1) -> dict[str, Any]:
    return {"kind": "COMMAND_ACK", "command": command, "system": system, "target_system": 245}


def test_a_command_its_acknowledgement_and_nothing_for_another_drone_are_its_own() -> None:
    others = (long(400, param1=0.0), ack(22), long(400, 2, param1=1.0), ack(400, 2))
    messages = table(long(400, param1=1.0), ack(400), *others)
    assert names(own_mavlink(messages, "arm", {1})) == {0: "arm", 1: "arm ack"}


def test_what_mavsdk_sends_before_goto_is_goto_s() -> None:
    goto = {"kind": "COMMAND_INT", "command": 192, "target_system": 1, "system": 245}
    messages = table(long(176, param2=4.0, param3=3.0), ack(176), goto, ack(192), long(176, param2=6.0))
    own = names(own_mavlink(messages, "goto", {1}))
    assert own == {0: "beside", 1: "beside ack", 2: "goto", 3: "goto ack"}
    assert names(own_mavlink(messages, "offboard", {1})) == {1: "offboard ack", 4: "offboard"}


@pytest.mark.parametrize(("name", "kind"), [("heading", "GLOBAL_POSITION_INT"), ("flight_mode", "HEARTBEAT")])
def test_a_state_s_own_are_the_drones_messages_and_what_asks_for_them(name: str, kind: str) -> None:
    number = {"GLOBAL_POSITION_INT": 33.0, "HEARTBEAT": 0.0}[kind]
    others = ({"kind": kind, "system": 245}, {"kind": "ATTITUDE", "system": 1}, long(511, param1=30.0))
    messages = table({"kind": kind, "system": 1}, long(511, param1=number), ack(511), *others)
    assert names(own_mavlink(messages, name, {1})) == {0: name, 1: "request", 2: "request ack"}


def test_a_bundle_is_a_state_s_own_where_it_has_that_state_in_it() -> None:
    both = drone_bundle([Battery(90), Heading(10.0)], stamp=7)
    (relayed,) = fog_bundles([(1, StampedState(Battery(90), 7, relay_stamp=8))])
    messages = table(
        {"kind": "publish", "link": "air:uav1:up", "topic": "drone1/states", "body": encode(both)},
        {"kind": "publish", "link": "wan:gs:down", "topic": "fog1/states", "body": encode(relayed)},
        {"kind": "publish", "link": "wan:gs:down", "topic": "fog1/states", "body": b"no bundle"},
        {"kind": "puback", "link": "wan:gs:up"},
    )
    assert names(own_mqttxt(messages, "battery", WAYS)) == {0: "battery", 1: "battery"}
    assert names(own_mqttxt(messages, "heading", WAYS)) == {0: "heading"}
    assert names(own_mqttxt(messages, "location", WAYS)) == {}


def test_a_result_is_its_command_s_own_and_a_stream_s_only_a_state_s() -> None:
    messages = table(
        {"kind": "publish", "link": "air:uav1:up", "topic": "drone1/commands_result/land", "body": b"\1"},
        {"kind": "publish", "link": "air:uav1:up", "topic": "drone1/commands_result/stream", "body": b"\1"},
    )
    assert names(own_mqttxt(messages, "land", WAYS)) == {0: "land result"}
    assert names(own_mqttxt(messages, "battery", WAYS)) == {1: "request result"}


def test_words_that_came_together_are_their_command_s_own() -> None:
    words = tuple(WordTogether(drone=n, session=n, stamp=1, word=Word.ACCEPTED) for n in (1, 2))
    body = encode(FogResultMessage(gs_session=1, seq=2, session=3, stamp=4, words=words))
    together = {"kind": "publish", "link": "wan:gs:down", "topic": "fog1/commands_result/land", "body": body}
    assert names(own_mqttxt(table(together), "land", WAYS)) == {0: "land result"}


def test_setpoints_are_those_that_go_to_the_drone() -> None:
    kind = "SET_POSITION_TARGET_LOCAL_NED"
    messages = table({"kind": kind, "link": "wan:gs:up"}, {"kind": kind, "link": "air:uav1:up"}, {"kind": "PING"})
    assert setpoints(messages.with_columns(pl.col("link").fill_null("wan:gs:up")), WAYS)["row"].to_list() == [0]
