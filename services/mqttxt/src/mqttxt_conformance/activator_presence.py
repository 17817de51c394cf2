"""Rules of an activator about presence: its drones', a second activator's, and its own end."""

from __future__ import annotations

import secrets

from mqttxt.protocol.codec import encode
from mqttxt.protocol.messages import FogPresence, Presence

from . import shapes
from .activator_kit import PATIENCE_S, ActivatorKit
from .deaf import leaves
from .registry import expect, rule


@rule("activator", "R9.2")
async def says_who_is_gone(kit: ActivatorKit) -> str:
    """A drone's will makes it unreachable, its birth reachable again."""
    kit.two.born(up=False)
    await kit.cloud.until(lambda: not kit.record(2).get("up", True), PATIENCE_S)
    down = kit.record(2)
    expect(down.get("up") is False, f"drone 2 is gone, its record says {down}")
    kit.two.born()
    await kit.cloud.until(lambda: kit.record(2).get("up"), PATIENCE_S)
    expect(kit.record(2).get("up") is True, f"drone 2 is back, its record says {kit.record(2)}")
    return f"gone: {down}; back: {kit.record(2)}"


@rule("activator", "R9.5")
async def refuses_a_second_uav_client(kit: ActivatorKit) -> str:
    """A second session of a drone's number gets `bound: false` while the first one answers."""
    other = secrets.randbelow(2**32 - 1) + 1
    mark = len(kit.one.leases)
    presence = encode(Presence(session=other, up=True))
    kit.fog.publish(kit.fog_side.reachable(1), presence, retain=True)

    def refused() -> list[int]:
        told = [lease for _, lease in kit.one.leases[mark:]]
        return [lease["nonce"] for lease in told if lease["drone_session"] == other and not lease["bound"]]

    await kit.fog.until(refused, PATIENCE_S)
    expect(refused(), f"session {other} beside {kit.one.session}, which answers: it was not told that it is refused")
    kit.one.born()
    bound = [lease for _, lease in kit.one.leases[mark:] if lease["drone_session"] == other and lease["bound"]]
    expect(not bound, f"session {other} was bound: {bound}")
    return f"session {other} beside {kit.one.session}: told bound false"


@rule("activator", "R9.1")
async def watches_its_retained_topics(kit: ActivatorKit) -> str:
    """When fogX/reachable or a drone's record shows another session, it publishes its own again."""
    mark = len(kit.cloud.heard)
    other = encode(FogPresence(session=secrets.randbelow(2**32 - 1) + 1, up=False))
    kit.cloud.publish(kit.topics.reachable, other, retain=True)

    def put_right() -> list[int]:
        found = [shapes.read("fog-presence", heard.payload) for heard in kit.cloud.since(mark, kit.topics.reachable)]
        return [presence["session"] for presence in found if presence["up"]]

    await kit.cloud.until(put_right, PATIENCE_S)
    expect(put_right()[-1:] == [kit.session], f"after another session's down came {put_right()} on fogX/reachable")
    return "birth again after another session's down"


@rule("activator", "R9.17")
async def leaves_a_connection_that_delivers_nothing(kit: ActivatorKit) -> str:
    """Where nothing comes from the cloud's broker, not even its birth, it ends the connection and connects anew."""
    kit.subject.need()
    return await leaves(kit, kit.cloud.address, kit.cloud)


@rule("activator", "R9.1")
async def will_carries_the_session(kit: ActivatorKit) -> str:
    """Killed, its will says `down` with its session."""
    kit.subject.need()
    mark = len(kit.cloud.heard)
    await kit.subject.kill()
    await kit.cloud.until(lambda: kit.cloud.since(mark, kit.topics.reachable), PATIENCE_S)
    came = [shapes.read("fog-presence", heard.payload) for heard in kit.cloud.since(mark, kit.topics.reachable)]
    is_own = bool(came) and (came[0]["session"], came[0]["up"]) == (kit.session, False)
    expect(is_own, f"SIGKILL: came {came}, expected session {kit.session}, down")
    return f"will {came[0]}"


@rule("activator", "R9.6")
async def a_second_one_refuses_to_start(kit: ActivatorKit) -> str:
    """Where another activator of the fog is live, it asks it, and stops without a birth of its own."""
    kit.subject.need()
    await kit.subject.kill()
    rival = secrets.randbelow(2**32 - 1) + 1
    await kit.cloud.publish(kit.topics.reachable, encode(FogPresence(session=rival, up=True)), retain=True)
    mark = len(kit.cloud.heard)
    kit.rival = rival
    await kit.subject.start()
    code = await kit.subject.ended()
    kit.rival = None
    births = [shapes.read("fog-presence", heard.payload) for heard in kit.cloud.since(mark, kit.topics.reachable)]
    expect(not births, f"session {rival} is live and answered: came {births}")
    expect(code is not None, f"session {rival} is live and answered: it goes on after 10 s")
    return f"session {rival} answered: it ended without a birth, with {kit.subject.ending}"


@rule("activator", "R9.3")
async def a_clean_stop_says_down(kit: ActivatorKit) -> str:
    """At a clean stop it publishes `down` itself, with its session."""
    kit.subject.need()
    await kit.subject.kill()
    await kit.cloud.publish(kit.topics.reachable, b"", retain=True)
    mark = len(kit.cloud.heard)
    await kit.subject.start()
    await kit.meet(mark)
    mark = len(kit.cloud.heard)
    kit.subject.terminate()
    code = await kit.subject.ended()
    await kit.cloud.until(lambda: kit.cloud.since(mark, kit.topics.reachable), PATIENCE_S)
    came = [shapes.read("fog-presence", heard.payload) for heard in kit.cloud.since(mark, kit.topics.reachable)]
    is_down = bool(came) and (came[-1]["session"], came[-1]["up"]) == (kit.session, False)
    expect(code == 0 and is_down, f"SIGTERM: exit code {code}; came {came}")
    return f"SIGTERM: {came[-1]}, exit code 0"
