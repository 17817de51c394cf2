"""The whole dialect over both brokers against the stand-in: any message, any MAV_CMD, and commands that take time."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import pytest

from mqttxt import Arm, Drone, GroundStation, Mavlink, MavlinkState, Outcome, StateUpdate, Stream, Word
from tests.rigs.processes import System, eventually

pytestmark = pytest.mark.integration


@pytest.fixture
async def station(system: System) -> AsyncIterator[GroundStation]:
    """A ground station that is registered at the fog and controls its drones."""
    async with GroundStation(system.cloud.url) as made:
        await made.connect([1])
        yield made


@pytest.fixture
async def drone(station: GroundStation) -> Drone:
    """Drone 1, reachable."""
    found = station.fog(1).drone(1)
    await eventually(lambda: found.is_reachable, "drone 1 is reachable")
    return found


async def _outcomes(drone: Drone, command: Arm | Mavlink | Stream) -> list[Outcome]:
    return [outcome async for outcome in drone.send(command)]


async def test_a_message_that_was_not_streamed_comes_on_request_and_ends(drone: Drone) -> None:
    """The stand-in's `normal` streams have no HIGHRES_IMU."""
    assert (await drone.send(Stream("mavlink/HIGHRES_IMU", 10.0))).completed
    stamps: set[object] = set()

    def are_many() -> bool:
        known = drone.states.get("mavlink/HIGHRES_IMU")
        if known is not None and isinstance(known.state, MavlinkState):
            stamps.add(known.state.values["time_usec"])
        return len(stamps) > 10

    await eventually(are_many, "eleven messages")
    assert (await drone.send(Stream("mavlink/HIGHRES_IMU", 0.0))).completed
    await eventually(lambda: (drone.states["mavlink/HIGHRES_IMU"].age_ms or 0) > 1000, "it has ended")


async def test_a_state_that_does_not_change_comes_all_the_same(station: GroundStation, drone: Drone) -> None:
    """On change alone ten of them would take five minutes."""
    assert (await drone.send(Stream("landed_state", 5.0))).completed
    stamps: set[int] = set()
    async with asyncio.timeout(30):
        async for event in station.events():
            if isinstance(event, StateUpdate) and (event.drone, event.state.name) == (1, "landed_state"):
                stamps.add(event.stamp)
            if len(stamps) == 10:
                break


@pytest.mark.parametrize(
    ("command", "word", "reason"),
    [
        (Stream("mavlink/NO_SUCH", 1.0), Word.DENIED, "unknown_message"),
        (Stream("mavlink/RAW_IMU", 1.0), Word.FAILED, "autopilot"),
        (Mavlink(246, (1.0, *[0.0] * 6)), Word.DENIED, "mav_cmd_not_enabled"),
        (Mavlink(21, (0.0,) * 7), Word.DENIED, "use_typed_command, land"),
        (Mavlink(183, (0.0,) * 7), Word.UNSUPPORTED, None),
    ],
)
async def test_what_cannot_be_has_its_word(
    drone: Drone, command: Stream | Mavlink, word: Word, reason: str | None
) -> None:
    last = await drone.send(command)
    assert (last.word, last.reason) == (word, reason)


async def test_a_mav_cmd_reaches_the_autopilot_once_and_is_completed_unobserved(drone: Drone, system: System) -> None:
    request_message = Mavlink(512, (242.0, *[float("nan")] * 6))
    before = len(system.commanded(1, 512))
    last = await drone.send(request_message)
    assert (last.word, last.observed) == (Word.COMPLETED, False)
    (received,) = system.commanded(1, 512)[before:]
    assert received["params"] == [242.0, *[None] * 6]


async def test_progress_is_heard_on_the_way_to_the_last_word(drone: Drone, system: System) -> None:
    system.control(1, {"set": {"in_progress": {"command": 400, "percents": [10, 10, 60, 255], "interval_s": 0.6}}})
    heard = await _outcomes(drone, Arm())
    assert [(o.word, o.percent) for o in heard] == [
        (Word.IN_PROGRESS, 10),
        (Word.IN_PROGRESS, 60),
        (Word.IN_PROGRESS, None),
        (Word.ACCEPTED, None),
        (Word.COMPLETED, None),
    ]
    assert len(system.commanded(1, 400)) == 1
