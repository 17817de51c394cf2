"""Rules of a broker about delivery: messages arrive whole, once and in order."""

from __future__ import annotations

from contextlib import AsyncExitStack
from functools import partial

from mqttxt.protocol.cbor import MAX_PAYLOAD

from .broker_kit import COMES_S, LARGEST_PACKET, BrokerKit, Peer, first_of, options, publish_properties
from .registry import Need, expect, rule
from .tap import NO_PUBACK, NOBODY_SUBSCRIBED

NEEDED = {"cloud": Need.NEEDED, "fog": Need.NEEDED, "drone": Need.NEEDED}
NEEDED_BY_ROLES = {"cloud": Need.NEEDED, "fog": Need.NEEDED, "drone": Need.UNUSED}
USEFUL = {"cloud": Need.USEFUL, "fog": Need.USEFUL, "drone": Need.USEFUL}
UNUSED = {"cloud": Need.UNUSED, "fog": Need.UNUSED, "drone": Need.UNUSED}
MANY = 200
CONNECTIONS = 20
AGAIN_S = 0.5
FILTERS = ("reachable", "clock", "states", "commands_result/#", "+/reachable", "+/+/+", "+/state/mavlink/+")
"""A ground station's filters, no two of which match the same topic."""


@rule("broker", "R2.1", needs=NEEDED)
async def carries_messages(kit: BrokerKit) -> str:
    """A message at QoS 0 and one at QoS 1 reach a subscriber as they were sent, and QoS 1 is acknowledged."""
    for qos in (0, 1):
        topic = kit.topic(f"carried/{qos}")
        acknowledged = kit.sender.publish(topic, bytes(range(256)), qos=qos)
        heard = await kit.hearer.come(topic)
        expect(heard, f"QoS {qos}: nothing came within {COMES_S:g} s")
        assert heard is not None
        expect(heard.payload == bytes(range(256)), f"QoS {qos}: {len(heard.payload)} other bytes came")
        expect(heard.qos == qos, f"sent at QoS {qos}, it came at QoS {heard.qos}")
    code = await acknowledged
    expect(code == 0, f"PUBACK has reason code 0x{code:02x}" if code != NO_PUBACK else "no PUBACK within 5 s")
    return "both came whole, each at its QoS"


@rule("broker", "R2.3", needs=NEEDED)
async def matches_filters(kit: BrokerKit) -> str:
    """A station's filters, with `+` and `#`, in one SUBSCRIBE: each message that one of them matches comes once."""
    below = kit.topic("filters/")
    topics = ("reachable", "commands_result/arm", "drone1/reachable", "drone1/state/armed", "drone1/state/mavlink/X")
    async with kit.peer() as peer:
        code = await peer.subscribe(*(f"{below}{one}" for one in FILTERS))
        expect(code < 0x80, f"SUBACK 0x{code:02x}")
        for one in (*topics, "init_connect", "drone1/commands/a/b"):
            await kit.publish(f"{below}{one}", b"1")
        await kit.all_before(peer, f"{below}clock")
        came = sorted(heard.topic.removeprefix(below) for heard in peer.heard if not heard.topic.endswith("clock"))
        expect(came == sorted(topics), f"came: {', '.join(came)}; expected: {', '.join(sorted(topics))}")
    return f"{len(FILTERS)} filters, {len(topics)} messages came once, 2 others did not"


@rule("broker", "R9.6", needs=NEEDED)
async def gives_filters_up(kit: BrokerKit) -> str:
    """After UNSUBACK nothing more comes by a filter."""
    given_up, kept = kit.topic("given-up"), kit.topic("kept")
    async with kit.peer() as peer:
        await peer.subscribe(given_up)
        await peer.subscribe(kept)
        await peer.unsubscribe(given_up)
        await kit.publish(given_up, b"1")
        await kit.all_before(peer, kept)
        expect(not peer.on(given_up), "a message came all the same")
    return "a message on it did not come, a later one on another topic did"


@rule("broker", "R9.1", "R11.13", needs=NEEDED_BY_ROLES)
async def delivers_to_its_publisher(kit: BrokerKit) -> str:
    """Who subscribes to a topic hears its own publishes there."""
    topic = kit.topic("own")
    async with kit.peer() as peer:
        await peer.subscribe(topic, options=options())
        await kit.all_before(peer, topic, by=peer)
    return "an own message came back"


@rule("broker", "R9.6", "R12.17", needs=NEEDED)
async def keeps_the_order(kit: BrokerKit) -> str:
    """QoS 1 messages of one publisher on one topic come in their order, each once."""
    return await _in_order(kit, 1)


@rule("broker", "R3.6", needs=USEFUL)
async def keeps_the_order_at_qos_0(kit: BrokerKit) -> str:
    """QoS 0 messages of one publisher on one topic come in their order, each once."""
    return await _in_order(kit, 0)


async def _in_order(kit: BrokerKit, qos: int) -> str:
    topic = kit.topic(f"order/{qos}")
    sent = [b"%d" % number for number in range(MANY)]
    for payload in sent:
        kit.sender.publish(topic, payload, qos=qos)
    await kit.hearer.until(lambda: len(kit.hearer.on(topic)) >= MANY, COMES_S)
    came = kit.hearer.on(topic)
    expect(came == sent, f"{len(came)} of {MANY} came" if len(came) != MANY else "they came in another order")
    return f"{MANY} messages came in their order"


@rule("broker", "R3.4", "R15.1", needs=NEEDED_BY_ROLES)
async def takes_the_longest_payload(kit: BrokerKit) -> str:
    """A payload of 61,440 bytes passes, to a client that announces 64 KiB as its largest packet."""
    topic, payload = kit.topic("longest"), bytes(MAX_PAYLOAD)
    announced = {"MaximumPacketSize": LARGEST_PACKET}
    largest = getattr(kit.sender.connack, "MaximumPacketSize", None)
    expect(largest is None or largest >= LARGEST_PACKET, f"its largest packet is {largest} bytes")
    async with kit.peer(announced=announced) as peer:
        await peer.subscribe(topic)
        await kit.publish(topic, payload)
        expect(await peer.come(topic, payload), f"it did not come within {COMES_S:g} s")
    return f"it came; the broker's largest packet: {'no limit' if largest is None else f'{largest} bytes'}"


@rule("broker", "R10.5", needs=USEFUL)
async def keeps_to_a_clients_largest_packet(kit: BrokerKit) -> str:
    """A packet longer than its client's Maximum Packet Size is left out, and the connection goes on."""
    topic = kit.topic("too-long")
    async with kit.peer(announced={"MaximumPacketSize": 1000}) as peer:
        await peer.subscribe(topic)
        await kit.publish(topic, bytes(2000))
        await kit.all_before(peer, topic)
        expect(bytes(2000) not in peer.on(topic), "2,000 bytes came to a client that takes 1,000")
    return "2,000 bytes did not come to a client that takes 1,000; the next message did"


@rule("broker", "R10.5", needs=USEFUL)
async def keeps_to_receive_maximum(kit: BrokerKit) -> str:
    """No more QoS 1 messages are under way to a client than its Receive Maximum, and the rest come once it has room."""
    topic, behind = kit.topic("receive-maximum"), kit.topic("receive-maximum/behind")
    async with kit.peer(manual_ack=True, announced={"ReceiveMaximum": 2}) as peer:
        await peer.subscribe(topic, behind)
        for number in range(4):
            await kit.publish(topic, b"%d" % number)
        kit.sender.publish(behind, b"", qos=0)  # Receive Maximum does not apply; a broker may still hold it back
        await peer.come(behind)
        early = len(peer.on(topic))
        expect(1 <= early <= 2, f"{early} of 4 came ahead of any PUBACK; expected 1 or 2")
        for _ in range(3):
            have = len(peer.on(topic))
            peer.acknowledge_all()
            await peer.until(partial(_has_more, peer, topic, have), COMES_S)
        expect(len(peer.on(topic)) >= 4, f"{len(peer.on(topic))} of 4 came after the PUBACKs")
    return f"{early} of 4 came ahead of the PUBACKs, the others behind them"


def _has_more(peer: Peer, topic: str, than: int) -> bool:
    return len(peer.on(topic)) > than


@rule("broker", "R10.2", needs=USEFUL)
async def takes_topic_aliases(kit: BrokerKit) -> str:
    """A client's topic alias stands for its topic: it comes to others under the full name."""
    most = getattr(kit.sender.connack, "TopicAliasMaximum", 0)
    expect(most > 0, "CONNACK has no Topic Alias Maximum: every topic goes out in full")
    topic = kit.topic("aliased")
    kit.sender.publish(topic, b"1", qos=0, properties=publish_properties(TopicAlias=1))
    kit.sender.publish("", b"2", qos=0, properties=publish_properties(TopicAlias=1))
    expect(await kit.hearer.come(topic, b"2"), "a message with an alias alone did not come under its topic")
    return f"it came; Topic Alias Maximum {most}"


@rule("broker", "R10.2", needs={**UNUSED, "cloud": Need.USEFUL})
async def sends_topic_aliases(kit: BrokerKit) -> str:
    """It uses aliases towards a client that allows them."""
    topic = kit.topic("alias-out")
    async with kit.peer(announced={"TopicAliasMaximum": 10}) as peer:
        await peer.subscribe(topic)
        await kit.all_before(peer, topic)
        expect(any(hasattr(heard.properties, "TopicAlias") for heard in peer.heard), "it sends topics in full")
    return "a message came with an alias"


@rule("broker", "R5.9", "R9.14", needs=USEFUL)
async def says_that_nobody_hears(kit: BrokerKit) -> str:
    """PUBACK has reason code 0x10 where nobody subscribes."""
    async with kit.peer() as peer:
        code = await peer.publish(f"{kit.target.prefix}mqttxt-conformance/nobody", b"1")
    expect(code == NOBODY_SUBSCRIBED, f"PUBACK has reason code 0x{code:02x}")
    return "PUBACK 0x10"


@rule("broker", "R9.4", needs=NEEDED)
async def takes_many_connections(kit: BrokerKit) -> str:
    """Twenty clients, as the drones of a fog, are connected at once from one address, and each is heard."""
    topic = kit.topic("many")
    async with AsyncExitStack() as stack:
        peers = [await stack.enter_async_context(kit.peer()) for _ in range(CONNECTIONS)]
        for number, peer in enumerate(peers):
            await kit.publish(topic, b"%d" % number, by=peer)
        await kit.hearer.until(lambda: len(kit.hearer.on(topic)) >= CONNECTIONS, COMES_S)
        expect(len(kit.hearer.on(topic)) == CONNECTIONS, f"{len(kit.hearer.on(topic))} of {CONNECTIONS} were heard")
    return f"{CONNECTIONS} were connected at once, and heard"


@rule("broker", "R1.1", needs=NEEDED)
async def carries_between_nodes(kit: BrokerKit) -> str:
    """What is published at one node comes to subscribers at every other, at QoS 1 and 0."""
    kit.need_nodes()
    nodes = range(len(kit.target.nodes))
    for sender in nodes:
        for hearer in (node for node in nodes if node != sender):
            topic = kit.topic(f"between/{sender}/{hearer}")
            async with kit.peer(sender) as by, kit.peer(hearer) as peer:
                await peer.subscribe(topic)
                expect(await _passes(kit, by, peer, topic), f"node {sender + 1} to {hearer + 1}: nothing came")
    return f"{len(nodes)} nodes, each to each other"


async def _passes(kit: BrokerKit, by: Peer, peer: Peer, topic: str) -> bool:
    """Whether messages arrive; they are sent repeatedly, as another node learns of a subscription a little later."""

    async def passed() -> bool:
        by.publish(topic, b"0", qos=0)
        await kit.publish(topic, b"1", by=by)
        both: bool = await peer.until(lambda: {b"0", b"1"} <= set(peer.on(topic)), AGAIN_S)
        return both

    return await first_of(passed)


@rule("broker", needs=UNUSED)
async def passes_user_properties(kit: BrokerKit) -> str:
    """User properties of a message come with it, in their order."""
    given = [("a", "1"), ("a", "2"), ("b", "3")]
    came = await _property(kit, "user", publish_properties(UserProperty=given), "UserProperty")
    expect(came == given, f"came: {came}")
    return "three came in their order"


@rule("broker", needs=UNUSED)
async def passes_response_topic_and_correlation(kit: BrokerKit) -> str:
    """Response topic and correlation data of a message come with it."""
    answer = kit.topic("answer")
    for name, value in (("ResponseTopic", answer), ("CorrelationData", b"\x00\x01")):
        came = await _property(kit, name, publish_properties(**{name: value}), name)
        expect(came == value, f"{name}: {came}")
    return "both came"


async def _property(kit: BrokerKit, name: str, properties: object, wanted: str) -> object:
    topic = kit.topic(f"property/{name}")
    await kit.publish(topic, b"1", properties=properties)
    heard = await kit.hearer.come(topic)
    expect(heard, f"{name}: the message did not come")
    return getattr(heard.properties, wanted, None) if heard is not None else None


@rule("broker", needs=UNUSED)
async def keeps_to_no_local(kit: BrokerKit) -> str:
    """A subscription with No Local does not get its client's own messages."""
    topic = kit.topic("no-local")
    async with kit.peer() as peer:
        await peer.subscribe(topic, options=options(noLocal=True))
        await kit.publish(topic, b"own", by=peer)
        await kit.all_before(peer, topic)
        expect(b"own" not in peer.on(topic), "the own message came")
    return "an own message did not come, another's did"


@rule("broker", needs=UNUSED)
async def shares_subscriptions(kit: BrokerKit) -> str:
    """Of two subscribers of a shared subscription one gets each message."""
    topic = kit.topic("shared")
    async with kit.peer() as one, kit.peer() as other:
        for peer in (one, other):
            code = await peer.subscribe(f"$share/conformance/{topic}", options=options())
            expect(code < 0x80, f"SUBACK 0x{code:02x}")
        for number in range(4):
            await kit.publish(topic, b"%d" % number)
        await one.until(lambda: len(one.on(topic)) + len(other.on(topic)) >= 4, COMES_S)
        came = len(one.on(topic)) + len(other.on(topic))
        expect(came == 4, f"{came} of 4 came")
    return "each of 4 messages came once"
