"""metrics.json against its schema: what breaks it is named with its place, also within what the schema refers to."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from testbed.fly.results import METRICS, read_json
from testbed.numbers.metrics.series import schema_error
from tests.handmade.finished import both, finished


@pytest.mark.parametrize(
    ("place", "value", "said"),
    [
        (["arm"], 1, "$.arm: 1 is not of type 'string'"),
        (["notes"], [1], "$.notes[0]: 1 is not of type 'string'"),
        (
            ["protocols", "mqttxt", "attempts", 0, "packets"],
            "many",
            "$.protocols.mqttxt.attempts[0].packets: 'many' is not of type 'integer'",
        ),
        (
            ["protocols", "mavlink", "attempts", 0, "mavlink", "streams", 0, "rate_hz"],
            -1,
            "$.protocols.mavlink.attempts[0].mavlink.streams[0].rate_hz: -1 is less than the minimum of 0",
        ),
        (["protocols", "mqttxt", "sent"], 7, "$.protocols.mqttxt: Additional properties are not allowed"),
    ],
)
def test_what_breaks_the_schema_is_named_with_its_place(
    place: list[Any], value: object, said: str, tmp_path: Path
) -> None:
    document = read_json(finished(tmp_path, *both()).path / METRICS)
    assert schema_error(document) is None
    *way, last = place
    part = document
    for step in way:
        part = part[step]
    part[last] = value
    assert (schema_error(document) or "").startswith(said)
