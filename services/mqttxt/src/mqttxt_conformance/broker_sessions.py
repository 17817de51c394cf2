"""Rules of a broker about connections: wills, sessions, keep-alive and message expiry."""

from __future__ import annotations

import asyncio

from .broker_delivery import NEEDED_BY_ROLES, UNUSED, USEFUL
from .broker_kit import COMES_S, BrokerKit, Peer, first_of, publish_properties, will_properties
from .registry import Need, expect, rule

KEEPALIVE_S = 2
SILENT_S = 10.0
"""Within which the broker must end a client with that keep-alive; by MQTT it does so after 1.5 times the keep-alive."""
ROLES_KEEPALIVE_S = 15
LATEST_WILL_S = 30
"""Three beacon intervals, after which a node counts as gone without a will too (R9.2)."""
DELAY_S = 2
EXPIRY_S = 1
HELD_S = 2
TAKEN_OVER = 0x8E
STORED = {"cloud": Need.UNUSED, "fog": Need.UNUSED, "drone": Need.NEEDED}
"""A drone's own broker keeps readings for an hour while the UAV client is away (R9.11)."""
PERSISTENT = {"SessionExpiryInterval": 3600}


@rule("broker", "R9.1", needs=NEEDED_BY_ROLES)
async def publishes_wills(kit: BrokerKit) -> str:
    """The will of a client whose connection breaks is published at once, and retained."""
    topic = kit.topic("will/broken")
    async with kit.mortal(topic) as (mortal, will):
        await mortal.close(cleanly=False)
        expect(await kit.hearer.come(topic, will), f"no will within {COMES_S:g} s of the connection's end")

    async def is_retained() -> bool:
        async with kit.peer() as peer:
            await peer.subscribe(topic)
            heard = await peer.come(topic, will, 0.5)
            return heard is not None and heard.retain

    expect(await first_of(is_retained), "the will came, and was not retained")
    return "it came, and was retained"


@rule("broker", "R9.3", needs=NEEDED_BY_ROLES)
async def keeps_wills_back(kit: BrokerKit) -> str:
    """The will of a client that leaves with DISCONNECT is not published."""
    topic = kit.topic("will/clean")
    async with kit.mortal(topic) as (mortal, will):
        await mortal.close()
    await kit.all_before(kit.hearer, topic)
    expect(will not in kit.hearer.on(topic), "it was published")
    return "it was not published"


@rule("broker", "R9.3", needs={**USEFUL, "drone": Need.UNUSED})
async def publishes_wills_on_request(kit: BrokerKit) -> str:
    """The will of a client that leaves with reason code 0x04 is published."""
    topic = kit.topic("will/asked")
    async with kit.mortal(topic) as (mortal, will):
        await mortal.leave_with_will()
        expect(await kit.hearer.come(topic, will), f"it did not come within {COMES_S:g} s")
    return "it came"


@rule("broker", "R10.4", needs=NEEDED_BY_ROLES)
async def ends_the_silent(kit: BrokerKit) -> str:
    """The will of a client that falls silent is published after one and a half of its keep-alive."""
    topic = kit.topic("will/silent")
    async with kit.mortal(topic, keepalive_s=KEEPALIVE_S) as (mortal, will):
        began_ms = kit.now_ms()
        await mortal.fall_silent()
        heard = await kit.hearer.come(topic, will, SILENT_S)
    expect(heard, f"with a keep-alive of {KEEPALIVE_S} s no will within {SILENT_S:g} s of silence")
    assert heard is not None
    return f"with a keep-alive of {KEEPALIVE_S} s it came {(heard.at_ms - began_ms) / 1000:.1f} s after the last word"


@rule("broker", "R10.4", needs={**USEFUL, "drone": Need.UNUSED})
async def leaves_the_keep_alive(kit: BrokerKit) -> str:
    """A keep-alive of 15 s is taken, or one whose will still comes before 30 s of silence."""
    async with kit.peer(keepalive_s=ROLES_KEEPALIVE_S) as peer:
        given = getattr(peer.connack, "ServerKeepAlive", ROLES_KEEPALIVE_S)
    expect(0 < given * 1.5 <= LATEST_WILL_S, f"Server Keep Alive is {given} s")
    return f"the keep-alive is {given} s"


@rule("broker", needs=UNUSED)
async def delays_wills(kit: BrokerKit) -> str:
    """A will with a delay comes when that is over, and not if its client is back before."""
    topic = kit.topic("will/delayed")
    delay = will_properties(WillDelayInterval=DELAY_S)
    async with kit.mortal(topic, will_properties=delay, announced=PERSISTENT) as (mortal, will):
        began_ms = kit.now_ms()
        await mortal.close(cleanly=False)
        heard = await kit.hearer.come(topic, will, DELAY_S + COMES_S)
    expect(heard, f"with a delay of {DELAY_S} s no will within {DELAY_S + COMES_S:g} s")
    assert heard is not None
    after_s = (heard.at_ms - began_ms) / 1000
    expect(after_s > DELAY_S / 2, f"with a delay of {DELAY_S} s it came after {after_s:.1f} s")
    return f"with a delay of {DELAY_S} s it came after {after_s:.1f} s"


@rule("broker", "R9.4", needs=NEEDED_BY_ROLES)
async def forgets_sessions(kit: BrokerKit) -> str:
    """A client that starts clean, with session expiry 0, gets nothing of what was published while it was away."""
    topic, client_id = kit.topic("forgotten"), kit.client_id()
    async with kit.peer(client_id=client_id) as peer:
        await peer.subscribe(topic)
    await kit.publish(topic, b"late")
    async with kit.peer(client_id=client_id) as peer:
        await peer.subscribe(topic)
        await kit.all_before(peer, topic)
        expect(b"late" not in peer.on(topic), "a message of the time in between came")
    return "a message of the time in between did not come"


@rule("broker", "R9.11", needs=STORED)
async def keeps_sessions(kit: BrokerKit) -> str:
    """A session with an expiry keeps what was not acknowledged and what came while its client was away."""
    topic, client_id = kit.topic("kept"), kit.client_id()
    async with kit.peer(client_id=client_id, manual_ack=True, announced=PERSISTENT) as peer:
        await peer.subscribe(topic)
        await kit.publish(topic, b"unacknowledged")
        expect(await peer.come(topic, b"unacknowledged"), "a message did not come")
    await kit.publish(topic, b"away")
    async with kit.peer(client_id=client_id, clean_start=False, announced=PERSISTENT) as peer:
        for payload in (b"unacknowledged", b"away"):
            expect(await peer.come(topic, payload), f"what was {payload.decode()} did not come after the reconnection")
    await _forget(kit, client_id)
    return "both came after the reconnection"


@rule("broker", "R4.9", needs={**USEFUL, "drone": Need.UNUSED})
async def drops_what_has_expired(kit: BrokerKit) -> str:
    """A message whose expiry has passed while it waited does not come."""
    topic, client_id = kit.topic("expired"), kit.client_id()
    await _leave_waiting(kit, topic, client_id, EXPIRY_S)
    async with kit.peer(client_id=client_id, clean_start=False, announced=PERSISTENT) as peer:
        await kit.all_before(peer, topic)
        expect(b"waits" not in peer.on(topic), f"after {HELD_S} s it came, with an expiry of {EXPIRY_S} s")
    await _forget(kit, client_id)
    return f"after {HELD_S} s it did not come, with an expiry of {EXPIRY_S} s"


@rule("broker", needs=UNUSED)
async def passes_the_remaining_expiry(kit: BrokerKit) -> str:
    """A message that waited comes with the rest of its expiry."""
    topic, client_id = kit.topic("expiry"), kit.client_id()
    await _leave_waiting(kit, topic, client_id, 60)
    async with kit.peer(client_id=client_id, clean_start=False, announced=PERSISTENT) as peer:
        heard = await peer.come(topic, b"waits")
        expect(heard, "a message that waited did not come")
        assert heard is not None
        rest_s = heard.expiry_s
    await _forget(kit, client_id)
    expect(rest_s is not None, "it came without an expiry")
    assert rest_s is not None
    expect(rest_s < 60, f"after {HELD_S} s it came with the whole {rest_s} s")
    return f"after {HELD_S} s it came with {rest_s} of 60 s"


async def _leave_waiting(kit: BrokerKit, topic: str, client_id: str, expiry_s: int) -> None:
    """Leave a message waiting for a client that is away; sleeps for HELD_S, because the passing of time is tested."""
    async with kit.peer(client_id=client_id, announced=PERSISTENT) as peer:
        await peer.subscribe(topic)
    await kit.publish(topic, b"waits", properties=publish_properties(MessageExpiryInterval=expiry_s))
    await asyncio.sleep(HELD_S)


async def _forget(kit: BrokerKit, client_id: str) -> None:
    """End a session that would outlive the kit."""
    async with kit.peer(client_id=client_id):
        pass


@rule("broker", "R9.4", needs={**USEFUL, "drone": Need.NEEDED})
async def takes_sessions_over(kit: BrokerKit) -> str:
    """A second client of the same id ends the first one's connection, with reason code 0x8E."""
    return await _taken_over(kit, 0)


@rule("broker", "R9.4", needs={**USEFUL, "drone": Need.UNUSED})
async def takes_sessions_over_between_nodes(kit: BrokerKit) -> str:
    """So it does where the second client is at another node."""
    kit.need_nodes()
    return await _taken_over(kit, 1)


async def _taken_over(kit: BrokerKit, node: int) -> str:
    client_id = kit.client_id()
    async with kit.peer(client_id=client_id) as first, kit.peer(node, client_id=client_id):
        await first.until(first.ended.done, COMES_S)
        expect(first.ended.done(), f"the first connection goes on after {COMES_S:g} s")
        expect(first.ended.result() == TAKEN_OVER, f"it ended with reason code 0x{first.ended.result():02x}")
    return "the first one ended with reason code 0x8E"


@rule("broker", "R9.1", needs=NEEDED_BY_ROLES)
async def publishes_wills_at_every_node(kit: BrokerKit) -> str:
    """The will of a client at one node comes to subscribers at every other."""
    kit.need_nodes()
    for node in range(1, len(kit.target.nodes)):
        topic = kit.topic(f"will/node{node}")
        async with kit.peer(node) as peer:
            await peer.subscribe(topic)

            async def is_heard(topic: str = topic, peer: Peer = peer) -> bool:
                async with kit.mortal(topic) as (mortal, will):
                    await mortal.close(cleanly=False)
                    return await peer.come(topic, will, 1.0) is not None

            expect(await first_of(is_heard), f"a will of node 1 did not come at node {node + 1}")
    return f"heard at all {len(kit.target.nodes)} nodes"
