"""The revocation list at brokers (docs/protocol.md, R11.13): who has the newer one gives it to the others."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from unittest.mock import create_autospec

import pytest

from mqttxt.core.address import BrokerAddress
from mqttxt.core.effects import Inbound, Log, Publish, Subscribe
from mqttxt.core.mqtt.sn.air import Air
from mqttxt.core.shared_lists import LISTS, LISTS_AT_ONCE, SharedLists
from mqttxt.protocol.cbor import MAX_PAYLOAD
from mqttxt.security.authority import Authority
from mqttxt.security.fleet import Fleet
from mqttxt.security.identity import Identity
from mqttxt.security.signed_by_authority import signed_list

TOPIC = "fleet/revoked"


def numbered(acme: Authority, *numbers: int) -> list[bytes]:
    """The fleet's lists of these numbers."""
    found = {1: acme.fleet.revoked.der}
    for number in range(2, max(numbers) + 1):
        acme.issue(f"gs-{number}")
        acme.revoke(f"gs-{number}")
        found[number] = acme.fleet.revoked.der
    return [found[number] for number in numbers]


def listed(acme: Authority) -> bytes:
    """The fleet's first list."""
    return numbered(acme, 1)[0]


class Bench:
    """A node with a list of its own, on two brokers that have granted the subscription."""

    def __init__(self, acme: Authority, own: bytes, patience_ms: int = 1000) -> None:
        self.fleet = Fleet(acme.fleet.authority, acme.fleet.read(own))
        self.lists = SharedLists(self.fleet, {"cloud": TOPIC, "fog": f"local/{TOPIC}"}, patience_ms)
        for link in ("cloud", "fog"):
            self.lists.on_subscribed(link, 0)

    def hear(self, payload: bytes, now_ms: int, link: str = "cloud") -> tuple[list[Any], bool]:
        return self.lists.on_message(link, Inbound(self.lists.topic(link) or "", payload, 1, True), now_ms)

    def until(self, now_ms: int, *, begin_ms: int = 0) -> list[tuple[int, str]]:
        """What is published until then: when, and where."""
        return [
            (at_ms, effect.link)
            for at_ms in range(begin_ms, now_ms + 1, 100)
            for effect in self.lists.tick(at_ms)
            if isinstance(effect, Publish)
        ]


def test_it_is_subscribed_to_where_it_is(acme: Authority) -> None:
    bench = Bench(acme, listed(acme))
    assert bench.lists.on_connected("cloud") == [Subscribe("cloud", (TOPIC,), ref=LISTS)]
    assert bench.lists.on_connected("fog") == [Subscribe("fog", (f"local/{TOPIC}",), ref=LISTS)]
    assert bench.lists.on_connected("sensors") == []


def test_without_a_fleet_there_are_no_lists() -> None:
    lists = SharedLists(None, {"cloud": TOPIC})
    assert (lists.on_connected("cloud"), lists.topic("cloud"), lists.tick(5000)) == ([], None, [])
    lists.on_disconnected("cloud")


def test_a_broker_that_has_none_is_given_it_once(acme: Authority) -> None:
    bench = Bench(acme, listed(acme))
    assert bench.until(10_000) == [(1000, "cloud"), (1000, "fog")]
    later = Bench(acme, listed(acme), patience_ms=3000)
    assert later.until(2900) == []
    assert later.lists.tick(3000) == [
        Publish(link, topic, later.fleet.revoked.der, qos=1, retain=True)
        for link, topic in (("cloud", TOPIC), ("fog", f"local/{TOPIC}"))
    ]


def test_a_broker_that_has_it_is_left_alone(acme: Authority) -> None:
    bench = Bench(acme, listed(acme))
    for link in ("cloud", "fog"):
        assert bench.hear(bench.fleet.revoked.der, 100, link) == ([], False)
        assert bench.lists.is_shown(link)
    assert bench.until(10_000) == []


def test_a_newer_list_counts_at_once_and_goes_to_the_other_broker_at_once(acme: Authority) -> None:
    old, new = numbered(acme, 1, 2)
    bench = Bench(acme, old)
    bench.hear(old, 100, "fog")
    assert bench.hear(new, 200) == ([], True)
    assert bench.fleet.revoked.number == 2
    bench.lists.on_newer(200)
    assert [(each.link, each.payload) for each in bench.lists.tick(200) if isinstance(each, Publish)] == [("fog", new)]
    assert bench.until(9000, begin_ms=300) == []


@pytest.mark.long
@pytest.mark.parametrize("wrong", ["older", "theirs", "garbage", "empty", "too long"])
def test_what_is_older_or_none_of_the_fleet_changes_nothing_and_is_put_right(
    acme: Authority, tmp_path: Path, wrong: str
) -> None:
    old, own = numbered(acme, 1, 2)
    theirs = numbered(Authority.create(tmp_path / "theirs", "acme"), 5)[0]
    shown = {"older": old, "theirs": theirs, "garbage": b"garbage", "empty": b"", "too long": b"\0" * (MAX_PAYLOAD + 1)}
    bench = Bench(acme, own)
    for link in ("cloud", "fog"):
        bench.hear(own, 0, link)
    effects, is_newer = bench.hear(shown[wrong], 500)
    assert not is_newer
    assert [type(effect) for effect in effects] == ([] if wrong == "older" else [Log])
    assert bench.fleet.revoked.number == 2
    bench.hear(shown[wrong], 1400)  # nothing puts it off
    assert bench.until(2000) == [(1500, "cloud")]
    for at_ms in range(2000, 3000, 20):  # and who says it all the time makes no storm
        bench.hear(shown[wrong], at_ms)
    assert bench.until(3500, begin_ms=2000) == [(3000, "cloud")]


def test_another_list_of_the_same_number_changes_nothing(acme: Authority) -> None:
    """As of an authority that was restored: two nodes must not go on replacing each other's."""
    own = numbered(acme, 2)[0]
    bench = Bench(acme, own)
    number = acme.fleet.revoked.number
    other = signed_list(acme._key, acme.fleet.authority, number, {})
    assert bench.hear(other, 100) == ([], False)
    assert bench.fleet.revoked.der == own
    assert bench.until(5000) == [(1000, "fog")]


def test_a_broker_that_lost_it_is_given_it_again(acme: Authority) -> None:
    bench = Bench(acme, listed(acme))
    bench.until(1000)
    bench.lists.on_disconnected("cloud")
    assert bench.until(5000, begin_ms=1100) == []
    bench.lists.on_subscribed("cloud", 6000)
    assert bench.until(9000, begin_ms=6000) == [(7000, "cloud")]


def test_of_a_flood_of_lists_a_share_is_read_and_then_the_broker_is_asked_again(
    acme: Authority, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A newer list is not lost by that: the broker retains it."""
    old, new = numbered(acme, 1, 2)
    bench = Bench(acme, old)
    read: list[bytes] = []
    whole = bench.fleet.read
    monkeypatch.setattr(bench.fleet, "read", lambda payload: (read.append(payload), whole(payload))[1])
    for number in range(10_000):
        bench.hear(b"garbage %d" % number, 100)
    assert len(read) == LISTS_AT_ONCE
    assert bench.hear(new, 110) == ([Log("flood", f"{TOPIC}: too many")], False)
    found = [effect for at_ms in range(200, 1500, 100) for effect in bench.lists.tick(at_ms)]
    assert [effect for effect in found if isinstance(effect, Subscribe)] == [Subscribe("cloud", (TOPIC,), ref=LISTS)]
    bench.lists.on_subscribed("cloud", 1600)
    assert bench.hear(new, 1600) == ([], True)
    assert bench.lists.on_connected("cloud") == [Subscribe("cloud", (TOPIC,), ref=LISTS)]


def test_its_own_list_costs_a_node_nothing_of_the_share(acme: Authority) -> None:
    old, new = numbered(acme, 1, 2)
    bench = Bench(acme, old)
    for _ in range(10 * LISTS_AT_ONCE):
        assert bench.hear(old, 100) == ([], False)
    assert bench.hear(new, 100) == ([], True)


def test_a_broker_that_is_only_told_hears_it_at_once_and_again_when_it_is_newer(acme: Authority) -> None:
    old, new = numbered(acme, 1, 2)
    fleet = Fleet(acme.fleet.authority, acme.fleet.read(old))
    lists = SharedLists(fleet, {}, 3000, {"sensors": TOPIC})
    assert lists.tick(0) == []
    assert (lists.on_connected("sensors"), lists.topic("sensors")) == ([], None)
    assert lists.tick(100) == [Publish("sensors", TOPIC, old, qos=1, retain=True)]
    assert lists.tick(5000) == []
    fleet.take(fleet.read(new))
    lists.on_newer(6000)
    assert lists.tick(6000) == [Publish("sensors", TOPIC, new, qos=1, retain=True)]
    lists.on_disconnected("sensors")
    assert lists.tick(7000) == []
    lists.on_connected("sensors")
    assert lists.tick(7100) == [Publish("sensors", TOPIC, new, qos=1, retain=True)]


def test_who_only_hears_takes_a_newer_list_and_publishes_none(acme: Authority) -> None:
    old, new = numbered(acme, 1, 2)
    fleet = Fleet(acme.fleet.authority, acme.fleet.read(old))
    lists = SharedLists(fleet, {"broker": TOPIC}, None)
    lists.on_subscribed("broker", 0)
    assert lists.on_message("broker", Inbound(TOPIC, new, 1, True), 10) == ([], True)
    lists.on_newer(10)
    lists.on_message("broker", Inbound(TOPIC, old, 1, True), 20)
    assert [lists.tick(at_ms) for at_ms in (100, 5000)] == [[], []]


def test_a_gateway_of_datagrams_passes_on_a_newer_list_alone(acme: Authority) -> None:
    older, own, newer = numbered(acme, 1, 2, 3)
    fleet = Fleet(acme.fleet.authority, acme.fleet.read(own))
    for identity, passed in ((create_autospec(Identity, fleet=fleet), [newer]), (None, [])):
        air = Air("127.0.0.1", 0, BrokerAddress.parse("mqtt://127.0.0.1"), "", lambda kind, detail: None, identity)
        assert [each for each in (older, own, newer, b"", b"no list") if air._is_newer_list(each)] == passed
