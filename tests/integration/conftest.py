"""Fixtures for tests with real brokers and processes."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from processes import Broker, System


@pytest.fixture
def system(tmp_path: Path) -> Iterator[System]:
    """Two drones on one fog, at QoS 1."""
    made = System(tmp_path)
    try:
        yield made.start()
    finally:
        made.close()


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    """A real Mosquitto."""
    made = Broker(tmp_path, "broker")
    try:
        yield made.start()
    finally:
        made.kill()
