"""Fixtures for tests with real brokers and processes."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Generator, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from mavsdk.asyncio import ComponentType, Configuration, Mavsdk

from mqttxt import Drone
from tests.rigs.container import Container
from tests.rigs.either_autopilot import flight_of
from tests.rigs.fleets import TwoFleets
from tests.rigs.gateway import Client, Ground
from tests.rigs.live_page import LivePage
from tests.rigs.processes import Broker, System
from tests.rigs.real_flights import Flight
from tests.rigs.served_page import Served
from tests.rigs.shaped_link import ShapedLink

MOST_SHOWN = 4000
"""Characters of the end of each log that a failed test shows."""


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """A failed test shows what each of its processes and containers said, for it may not fail a second time."""
    report = yield
    if report.failed and isinstance(item, pytest.Function):
        report.sections += [(log, text[-MOST_SHOWN:]) for log, text in _logs(item.funcargs.values()).items()]
    return report


def _logs(arguments: Iterable[Any]) -> dict[str, str]:
    """By name, what is in the folders that a test has used; of containers that still run, what they said so far."""
    folders: dict[Path, None] = {}
    for argument in arguments:
        for container in (argument, *vars(argument).values()) if hasattr(argument, "__dict__") else ():
            if isinstance(container, Container):
                container.save_log()
                folders[container.log.parent] = None
        if isinstance(argument, Path) and argument.is_dir():
            folders[argument] = None
    return {log.name: log.read_text(errors="replace") for folder in folders for log in sorted(folder.glob("*.log"))}


@pytest.fixture
def system(tmp_path: Path) -> Iterator[System]:
    """Two drones on one fog, at QoS 1."""
    with closing(System(tmp_path)) as made:
        yield made.start()


@pytest.fixture(scope="module")
def shared_system(tmp_path_factory: pytest.TempPathFactory) -> Iterator[System]:
    """The same, for all tests of a file."""
    with closing(System(tmp_path_factory.mktemp("system"))) as made:
        yield made.start()


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TwoFleets]:
    """The fleets `acme` and `acme/eu` in one cloud, for all tests of a file."""
    with closing(TwoFleets(tmp_path_factory.mktemp("fleets"))) as made:
        yield made.start()


@pytest.fixture(scope="module")
def page(shared_system: System) -> Iterator[Served]:
    """The live page of `shared_system`."""
    served = Served(shared_system.folder, shared_system.cloud, "page")
    yield served
    served.process.kill()


@pytest.fixture(scope="module")
def browser() -> Iterator[LivePage]:
    """Chromium, for all tests of a file."""
    with LivePage() as started:
        yield started


@pytest.fixture(scope="session")
def link() -> Iterator[ShapedLink]:
    """Two nodes and the network between them, in containers; each test starts on it what it needs."""
    with ShapedLink() as made:
        yield made


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Flight]:
    """A real PX4 with its UAV client, fog and cloud, for all tests of a file."""
    with flight_of("px4", tmp_path_factory.mktemp("flight")) as made:
        yield made


@pytest.fixture
async def drone(flight: Flight) -> AsyncIterator[Drone]:
    """The drone of `flight`, under a station's control."""
    async with flight.drone() as drone:
        yield drone


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    """A real Mosquitto."""
    made = Broker(tmp_path, "broker")
    try:
        yield made.start()
    finally:
        made.kill()


@pytest.fixture
def ground(tmp_path: Path) -> Iterator[Ground]:
    with closing(Ground(tmp_path)) as system:
        yield system.start()


@pytest.fixture
async def mavsdk(ground: Ground) -> AsyncIterator[Mavsdk]:
    asyncio.get_running_loop().set_default_executor(ThreadPoolExecutor(16))
    made = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    try:
        await made.add_any_connection(f"udpin://127.0.0.1:{ground.udp}")
        yield made
    finally:
        made.destroy()


@pytest.fixture
def client(ground: Ground) -> Iterator[Client]:
    made = Client(ground.tcp)
    made.until(lambda message: message.get_type() == "HEARTBEAT" and message.get_srcSystem() == 1, "drone 1")
    yield made
    made.close()
