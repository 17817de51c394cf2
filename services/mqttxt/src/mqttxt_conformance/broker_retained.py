"""Rules of a broker about retained messages, also across its nodes."""

from __future__ import annotations

from .broker_delivery import UNUSED, USEFUL
from .broker_kit import COMES_S, BrokerKit, Peer, first_of, options
from .registry import Need, expect, rule

PRESENCE = {"cloud": Need.USEFUL, "fog": Need.NEEDED, "drone": Need.UNUSED}
"""The cloud broker need not: activators answer registrations with presence (R6.13). A fog's activator relies on it."""
SEND_ALWAYS, SEND_IF_NEW, SEND_NEVER = range(3)
"""Retain Handling."""


async def _shown(kit: BrokerKit, wanted: str, topic: str, node: int = 0) -> bytes | None:
    """The retained payload on `topic` that a new subscriber to `wanted` gets."""
    marker = f"{topic}-marker"
    async with kit.peer(node) as peer:
        await peer.subscribe(wanted)
        await peer.subscribe(marker, options=options())
        await kit.all_before(peer, marker, by=peer if node else None)
        found = [heard.payload for heard in peer.heard if heard.topic == topic and heard.retain]
    return found[-1] if found else None


@rule("broker", "R9.1", "R11.13", needs={**PRESENCE, "drone": Need.USEFUL})
async def retains(kit: BrokerKit) -> str:
    """A new subscriber to a topic is shown the newest retained message with RETAIN, and none that was taken back."""
    topic = kit.topic("retained/one")
    await kit.retain(topic, b"old")
    await kit.retain(topic, b"new")

    async def is_new() -> bool:
        return await _shown(kit, topic, topic) == b"new"

    expect(await first_of(is_new), f"shown: {await _shown(kit, topic, topic)!r}; expected b'new'")
    await kit.retain(topic, b"")

    async def is_gone() -> bool:
        return await _shown(kit, topic, topic) is None

    expect(await first_of(is_gone), "an empty payload does not take it back")
    return "the newest was shown, and after an empty payload none"


@rule("broker", "R9.1", "R6.9", "R12.6", needs=PRESENCE)
async def shows_retained_by_wildcard(kit: BrokerKit) -> str:
    """A new subscriber by `+` is shown what is retained on the topics that the filter matches."""
    topic = kit.topic("wildcard/drone1/reachable")
    await kit.retain(topic, b"up")
    wanted = kit.topic("wildcard/+/reachable")

    async def is_shown() -> bool:
        return await _shown(kit, wanted, topic) == b"up"

    expect(await first_of(is_shown), "nothing was shown; by the topic's full name it is another rule")
    return "it was shown"


@rule("broker", "R9.6", needs={**USEFUL, "drone": Need.UNUSED})
async def shows_retained_first(kit: BrokerKit) -> str:
    """What is retained is shown before what its subscriber publishes after the SUBACK comes back."""
    topic, own = kit.topic("first/retained"), kit.topic("first/own")
    await kit.retain(topic, b"1")
    async with kit.peer() as peer:
        await peer.subscribe(topic)
        await peer.subscribe(own, options=options())
        await kit.all_before(peer, own, by=peer)
        topics = [heard.topic for heard in peer.heard]
    expect(topic in topics, "nothing retained was shown before the own message came back")
    return "it was shown before the own message came back"


@rule("broker", "R6.13", needs=PRESENCE)
async def retains_on_every_node(kit: BrokerKit) -> str:
    """What is retained by a publisher at one node is shown to subscribers at every other."""
    kit.need_nodes()
    for node in range(1, len(kit.target.nodes)):
        topic = kit.topic(f"nodes/{node}")
        await kit.retain(topic, b"1")

        async def is_shown(topic: str = topic, node: int = node) -> bool:
            return await _shown(kit, topic, topic, node) == b"1"

        expect(await first_of(is_shown), f"what was retained at node 1 is not shown at node {node + 1}")
    return f"shown at all {len(kit.target.nodes)} nodes"


@rule("broker", "R5.2", needs={**USEFUL, "drone": Need.UNUSED})
async def keeps_to_retain_handling(kit: BrokerKit) -> str:
    """A subscription with Retain Handling 2 is shown nothing that is retained."""
    topic = kit.topic("handling")
    await kit.retain(topic, b"old")
    async with kit.peer() as peer:
        await peer.subscribe(topic, options=options(retainHandling=SEND_NEVER))
        await kit.all_before(peer, topic)
        expect(b"old" not in peer.on(topic), "a retained message came")
    return "a retained message did not come, a live one did"


@rule("broker", "R5.2", needs={**USEFUL, "drone": Need.UNUSED})
async def keeps_retain_as_published(kit: BrokerKit) -> str:
    """A subscription with Retain As Published sees RETAIN on live messages; another one does not."""
    topic = kit.topic("as-published")
    async with kit.peer() as one, kit.peer() as other:
        await one.subscribe(topic, options=options(retainAsPublished=True))
        await other.subscribe(topic, options=options(retainAsPublished=False))
        await kit.retain(topic, b"1")
        seen = [await _retain_of(peer, topic) for peer in (one, other)]
    expect(seen[0], "RETAIN does not come with the option")
    expect(not seen[1], "RETAIN comes without the option")
    return "RETAIN came with the option, and not without"


async def _retain_of(peer: Peer, topic: str) -> bool:
    heard = await peer.come(topic)
    expect(heard, f"a live message did not come within {COMES_S:g} s")
    return heard is not None and heard.retain


@rule("broker", needs=UNUSED)
async def keeps_to_send_if_new(kit: BrokerKit) -> str:
    """With Retain Handling 1 only a subscription that is new is shown what is retained."""
    topic = kit.topic("if-new")
    await kit.retain(topic, b"1")
    async with kit.peer() as peer:
        for _ in range(2):
            await peer.subscribe(topic, options=options(retainHandling=SEND_IF_NEW))
        await kit.all_before(peer, topic)
        count = peer.on(topic).count(b"1")
    expect(count == 1, f"shown {count} times for two SUBSCRIBEs; expected once")
    return "shown once for two SUBSCRIBEs"
