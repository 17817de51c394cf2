"""What the tests of this folder fly leaves nothing behind."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.e2e.flying import containers


@pytest.fixture(autouse=True)
def _nothing_is_left() -> Iterator[None]:
    yield
    assert containers() == {}
