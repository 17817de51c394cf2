"""Topic aliases: whatever is published, the broker sees the topic that was meant."""

from __future__ import annotations

from hypothesis import example, given
from hypothesis import strategies as st

from mqttxt.core.mqtt.aliases import AliasTable

topics = st.sampled_from([f"drone{drone}/state/{name}" for drone in range(1, 6) for name in ("battery", "location")])


class Receiver:
    """A broker's side of the aliases of one connection (MQTT 5.0, 3.3.2.3.4)."""

    def __init__(self, maximum: int) -> None:
        self.maximum = maximum
        self.topics: dict[int, str] = {}

    def topic_of(self, topic: str, alias: int | None) -> str:
        if alias is None:
            return topic
        assert 1 <= alias <= self.maximum
        if topic:
            self.topics[alias] = topic
        return self.topics[alias]


@given(st.lists(topics), st.integers(0, 12))
@example(["drone1/state/battery"], 0)
def test_the_broker_sees_the_topic_that_was_meant(published: list[str], maximum: int) -> None:
    table, receiver = AliasTable(maximum), Receiver(maximum)
    assert [receiver.topic_of(*table.shorten(topic)) for topic in published] == published


@given(st.lists(topics), st.integers(0, 12))
def test_a_topic_goes_out_in_full_once_while_aliases_last(published: list[str], maximum: int) -> None:
    table = AliasTable(maximum)
    in_full = [short for short, _ in map(table.shorten, published) if short]
    named = list(dict.fromkeys(published))
    assert all(in_full.count(topic) == 1 for topic in named[:maximum])
    assert all(in_full.count(topic) == published.count(topic) for topic in named[maximum:])
