"""Births of stations on their way to signed drones (docs/protocol.md, R12.6): several programs with one identity."""

from __future__ import annotations

import pytest

from mqttxt.activator.births import AGAIN
from mqttxt.core.effects import Publish
from mqttxt.core.session_owners import MOST_OF_ONE
from mqttxt.protocol.codec import encode
from mqttxt.protocol.control import Registration
from mqttxt.protocol.messages import Presence
from tests.simulation.signed import OTHER_SESSION
from tests.simulation.signing import seal
from tests.simulation.world import GS_SESSION, World

TOPIC = "gs/g/reachable"


def birth(session: int) -> bytes:
    station = seal("gs-g")
    presence = Presence(session=session, up=True, revoked=station.identity.fleet.revoked.number)
    return station.sign(TOPIC, encode(presence), with_certificate=True).encode()


def register(world: World, session: int) -> None:
    world.activator.leases.register(Registration(name="g", session=session, nonce=1, lease_s=30), world.now_ms)


def told(world: World, *sessions: int) -> list[bytes]:
    """What the drones are told of births that the broker shows."""
    out = [effect for session in sessions for effect in world.hears("activator", TOPIC, birth(session))]
    return [effect.payload for effect in out if isinstance(effect, Publish) and effect.topic == "drone1/stations"]


def test_programs_of_one_station_cost_the_drones_each_birth_once(world: World) -> None:
    """They put the topic right in turn, each once a second, for as long as both run."""
    register(world, OTHER_SESSION)
    assert told(world, OTHER_SESSION, GS_SESSION, OTHER_SESSION, GS_SESSION) == [birth(OTHER_SESSION)]


def test_a_drone_that_starts_anew_is_told_the_program_that_is_registered_whichever_birth_came_last(
    world: World,
) -> None:
    told(world, OTHER_SESSION)
    before = len(world.sent)
    world.restart_uav(0x98, [])
    sent = [publish.payload for _, publish in world.sent[before:] if publish.topic == "drone1/stations"]
    assert sent == [birth(GS_SESSION)]


def test_a_drone_that_started_anew_meanwhile_is_told_a_program_that_registers_again(world: World) -> None:
    """Without its birth the drone reads nothing of that program, not even a question."""
    register(world, OTHER_SESSION)
    assert told(world, OTHER_SESSION) == [birth(OTHER_SESSION)]
    world.activator.leases.end(("g", OTHER_SESSION), world.now_ms)
    world.restart_uav(0x98, [])
    register(world, OTHER_SESSION)
    assert told(world, OTHER_SESSION) == [birth(OTHER_SESSION)]


@pytest.mark.parametrize(("others", "times"), [(AGAIN - 1, 0), (AGAIN, 1)])
def test_a_program_that_runs_on_is_told_again_before_a_drone_forgets_it(world: World, others: int, times: int) -> None:
    for session in range(1000, 1000 + others):
        register(world, session)
        told(world, session)
    assert told(world, GS_SESSION) == times * [birth(GS_SESSION)]


def test_of_programs_that_came_and_went_no_more_births_are_kept_than_sessions(world: World) -> None:
    for session in range(1000, 1000 + 2 * MOST_OF_ONE):
        world.now_ms += 1000
        told(world, session)
    assert len(world.activator._births._stations) == MOST_OF_ONE + 1, "the registered one is kept"
