"""Uploads of 100 items two seconds of round trip away, where one message of twenty is lost each way."""

from __future__ import annotations

import os
import random
import statistics
from dataclasses import dataclass

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt.core.effects import Publish
from mqttxt.protocol.codec import decode
from mqttxt.protocol.commands import Disarm, UploadPlan
from mqttxt.protocol.messages import ResultMessage, Word
from mqttxt.protocol.plans import PLAN, PlanItem, PlanObject
from mqttxt.station.transfers import Staging
from tests.simulation.far import FarFlight

ROUND_TRIP_S = 2.0
LONGER_MS = 60
"""What 1 KiB and its headers take at 256 kbit/s, twice rounded up to a step of the simulation."""


@dataclass
class Uploaded:
    total_s: float
    at_drone_s: float

    @property
    def on_the_way_s(self) -> float:
        return self.total_s - self.at_drone_s


def survey(number: int) -> PlanObject:
    """100 items of uneven numbers: lines of waypoints with a height of this upload's own."""
    rng = random.Random(number)
    items = [
        PlanItem(
            mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT,
            mavlink.MAV_CMD_NAV_WAYPOINT,
            (0.0, 0.0, 0.0, None),
            473_977_420 + line * 1797 + rng.randint(-200, 200),
            85_455_940 + (line + side) % 2 * 22_333 + rng.randint(-200, 200),
            20.0 + number % 7,
            True,
        )
        for line in range(50)
        for side in (0, 1)
    ]
    return PlanObject(mission=tuple(items))


def upload(flight: FarFlight, plan: PlanObject) -> Uploaded:
    begun_ms, before = flight.now_ms, len(flight.sent)
    staging = Staging(flight.gs.fog(1), 1, PLAN, plan.packed())
    flight.run("gs", flight.gs.transfers.begin(staging, flight.now_ms))
    while not staging.is_over:
        flight.fly(0.1)
        assert flight.now_ms - begun_ms < 300_000, "not staged in five minutes"
    sent = flight.send(UploadPlan(staging.hash), ttl_ms=30_000)
    forwarded_ms = said_ms = None
    while (last := flight.last_of(sent)) is None:
        flight.fly(0.02)
        forwarded_ms = forwarded_ms or _first(flight, before, "drone1/commands")
        said_ms = said_ms or _completed(flight, before)
    assert (last.word, last.reason) == (Word.COMPLETED, None)
    assert forwarded_ms is not None
    assert said_ms is not None
    return Uploaded((flight.now_ms - begun_ms) / 1000, (said_ms - forwarded_ms) / 1000)


def _first(flight: FarFlight, after: int, topic: str) -> int | None:
    return flight.now_ms if any(p.topic == topic for _, p in flight.sent[after:]) else None


def _completed(flight: FarFlight, after: int) -> int | None:
    results = [p for who, p in flight.sent[after:] if who == "uav" and p.topic.endswith("commands_result/upload_plan")]
    return flight.now_ms if any(decode(ResultMessage, p.payload).word is Word.COMPLETED for p in results) else None


@pytest.mark.long
def test_every_upload_completes_within_four_round_trips_and_the_autopilots_time(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with capsys.disabled():
        fly_uploads(10)


@pytest.mark.long
@pytest.mark.timeout(900)
@pytest.mark.soak(
    "services/mqttxt/src/mqttxt/activator/bulk_relay.py",
    "services/mqttxt/src/mqttxt/drone/bulk.py",
    "services/mqttxt/src/mqttxt/protocol/bulk.py",
    "services/mqttxt/src/mqttxt/station/transfers.py",
    "tests/simulation/far.py",
)
def test_300_of_300_uploads_complete_within_that(capsys: pytest.CaptureFixture[str]) -> None:
    with capsys.disabled():
        fly_uploads(300)


def fly_uploads(count: int) -> None:
    """Upload one plan after the other; each completes, or fails the test."""
    flight = FarFlight().begin("px4")
    flight.is_far = True
    flight.fly(30)
    uploads = []
    for number in range(count):
        uploads.append(upload(flight, survey(number)))
        flight.sent.clear()
        flight.heard.clear()
        flight.wrote.clear()
    on_the_way_s = sorted(one.on_the_way_s for one in uploads)
    median_s = statistics.median(on_the_way_s)
    at_drone_s = statistics.median(one.at_drone_s for one in uploads)
    print(
        f"\n{len(uploads)} uploads of 100 items ({len(survey(0).packed())} bytes): on the way {median_s:.1f} s "
        f"(median, {on_the_way_s[0]:.1f} to {on_the_way_s[-1]:.1f}), at the drone {at_drone_s:.1f} s"
    )
    assert median_s <= 4 * ROUND_TRIP_S


def _delay_ms(flight: FarFlight) -> int:
    """How long a command takes to its activator."""
    flight.sent.clear()
    sent_ms = flight.now_ms
    flight.send(Disarm(), ttl_ms=30_000)
    while not any(p.topic == "drone1/commands" for who, p in flight.sent if who == "activator"):
        flight.fly(0.02)
    return flight.now_ms - sent_ms


@pytest.mark.long
def test_a_transfer_delays_commands_by_no_more_than_its_window(capsys: pytest.CaptureFixture[str]) -> None:
    flight = FarFlight().begin("px4")
    flight.is_far = True
    flight.up.loss = flight.down.loss = 0.0
    flight.fly(30)
    alone_ms = _delay_ms(flight)
    staging = Staging(flight.gs.fog(1), 1, PLAN, os.urandom(30_000))
    flight.run("gs", flight.gs.transfers.begin(staging, flight.now_ms))
    delays_ms = []
    for _ in range(8):
        while flight.up.free_ms <= flight.now_ms:  # the worst moment is when a piece has just left
            flight.fly(0.02)
        delays_ms.append(_delay_ms(flight))
        flight.fly(1)
    with capsys.disabled():
        print(f"\na command to its fog: {alone_ms} ms, {min(delays_ms)} to {max(delays_ms)} ms during a transfer")
    assert not staging.is_over
    assert max(delays_ms) <= alone_ms + LONGER_MS
    under_way = [publish for _, _, publish in flight.up.under_way if isinstance(publish, Publish)]
    assert sum(len(publish.payload) for publish in under_way) < 1500
