"""MQTT-XT fetches flight logs of a real PX4 and ArduCopter: after a flight, with commands meanwhile, and cut off.

PX4_DIR=FOLDER and ARDUPILOT_DIR=FOLDER name them.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from mqttxt import Drone, FlightLog, LogProgress, TransferFailed, Word
from mqttxt.drone.log_work import BLOCK_BYTES
from tests.rigs.either_autopilot import flight_of
from tests.rigs.processes import eventually
from tests.rigs.real_flights import Flight

pytestmark = [pytest.mark.integration, pytest.mark.alone, pytest.mark.timeout(600)]

WHERE = {"px4": ("flight-logs", "*.ulg"), "copter": ("logs", "*.BIN")}
"""Where each kind writes its logs, and what they are called."""


@dataclass
class Tried:
    flight: Flight
    kind: str

    @property
    def written(self) -> list[Path]:
        """The autopilot's own files."""
        folder, pattern = WHERE[self.kind]
        return sorted((self.flight.folder / folder).rglob(pattern))


@pytest.fixture(scope="module", params=["px4", "copter"])
def tried(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tried]:
    folder: Path = tmp_path_factory.mktemp("flight")
    flight = flight_of(request.param, folder)
    with flight:
        yield Tried(flight, request.param)


@pytest.fixture
async def drone(tried: Tried) -> AsyncIterator[Drone]:
    async with tried.flight.drone() as drone:
        if not tried.written or max(path.stat().st_size for path in tried.written) < 1_000_000:
            await _fly(drone)
        yield drone


async def _fly(drone: Drone) -> None:
    """So that there is something to read."""
    assert (await drone.arm()).completed
    assert (await drone.takeoff(10)).completed
    assert (await drone.land()).completed


async def _largest(drone: Drone) -> FlightLog:
    return max(await drone.logs(), key=lambda log: log.size)


def _is_of(tried: Tried, data: bytes) -> bool:
    """Whether an autopilot's own file begins with these bytes: it may have grown since."""
    return any(path.read_bytes()[: len(data)] == data for path in tried.written)


async def test_a_log_arrives_as_the_autopilot_wrote_it(
    tried: Tried, drone: Drone, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, target, told = await _largest(drone), tmp_path / "flight.log", list[tuple[float, LogProgress]]()
    begun_s = time.monotonic()
    await drone.download_log(log, target, progress=lambda one: told.append((time.monotonic() - begun_s, one)))
    took_s = time.monotonic() - begun_s
    data = target.read_bytes()
    assert len(data) == log.size > 500_000
    assert _is_of(tried, data)
    read_s = next(at_s for at_s, one in told if one.is_at_drone)
    with capsys.disabled():
        carried = f"{told[-1][1].size} bytes compressed carried in {took_s - read_s:.1f} s"
        print(f"\n{tried.kind}: {log.size} bytes read from the autopilot in {read_s:.1f} s, {carried}")


async def test_commands_do_not_wait_for_a_log_and_arming_ends_it(
    tried: Tried, drone: Drone, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _forget(tried)
    name = "MPC_XY_CRUISE" if tried.kind == "px4" else "WPNAV_SPEED"
    value = (await drone.parameters())[name]
    alone_s = await _set_in_s(drone, name, value)
    log, target = await _largest(drone), tmp_path / "flight.log"
    told: list[LogProgress] = []
    fetching = asyncio.create_task(drone.download_log(log, target, progress=told.append))
    await eventually(lambda: bool(told) and told[-1].done > 300_000, "it is read", 60)
    reading_s = await _set_in_s(drone, name, value)
    before = told[-1].done
    await eventually(lambda: told[-1].done > before, "it goes on", 60)
    outcome = await drone.arm()
    assert (outcome.word, outcome.reason) == (Word.COMPLETED, None)
    with pytest.raises(TransferFailed, match="armed"):
        await fetching
    assert not target.exists()
    before = max(one.done for one in told)
    with pytest.raises(TransferFailed, match="armed"):
        await drone.logs()
    assert (await drone.disarm()).completed
    assert await _first_place(drone, log, target) >= before - BLOCK_BYTES
    with capsys.disabled():
        print(
            f"\n{tried.kind}: a command's last word after {alone_s:.2f} s alone, {reading_s:.2f} s while a log is read"
        )


async def _set_in_s(drone: Drone, name: str, value: float) -> float:
    """How long a command takes that the autopilot has to answer."""
    begun_s = time.monotonic()
    assert (await drone.set_parameter(name, value)).completed
    return time.monotonic() - begun_s


def _forget(tried: Tried) -> None:
    for path in (tried.flight.folder / "uav.journal.logs").iterdir():
        path.unlink()


async def test_a_killed_client_goes_on_where_it_was(tried: Tried, drone: Drone, tmp_path: Path) -> None:
    _forget(tried)
    log, target = await _largest(drone), tmp_path / "flight.log"
    told: list[LogProgress] = []
    fetching = asyncio.create_task(drone.download_log(log, target, progress=told.append))
    await eventually(lambda: bool(told) and told[-1].done > 400_000, "it is read", 60)
    before = told[-1].done
    tried.flight.uav.kill()
    fetching.cancel()
    tried.flight.uav.start().wait_ready()
    await eventually(lambda: drone.is_controlled, "it is back")
    assert await _first_place(drone, log, target) >= before - 2 * BLOCK_BYTES


async def _first_place(drone: Drone, log: FlightLog, target: Path) -> int:
    """Where the reading of a log goes on: how many bytes there are before the first new ones."""
    told: list[LogProgress] = []
    fetching = asyncio.create_task(drone.download_log(log, target, progress=told.append))
    await eventually(lambda: any(one.done for one in told), "it is read", 60)
    fetching.cancel()
    return next(one.done for one in told if one.done)
