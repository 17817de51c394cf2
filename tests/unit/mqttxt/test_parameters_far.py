"""1,400 parameters over a telemetry radio (profile `sik`): 64 kbit/s for both directions, one message of 100 lost."""

from __future__ import annotations

import random

import pytest

from mqttxt.activator.drones import FOG
from mqttxt.core.effects import Publish
from mqttxt.protocol.commands import SetParameter
from mqttxt.protocol.messages import Word
from mqttxt.protocol.parameters import PARAMETERS, ParameterSet
from mqttxt.station.transfers import Fetching
from sitl.parameters import BytewiseParameters, Parameters, Spec
from sitl.px4.parameters import SPECS
from tests.simulation.far import HEADERS_BYTES, Direction, FarFlight

COUNT = 1400
MOST_S = 60


class RadioFlight(FarFlight):
    """The drone is behind a radio, whose one channel both directions share."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._air = Direction(60, 64e3, 0.01)
        self.up = self.down = self._air

    def begin(self, like: str) -> RadioFlight:
        super().begin(like)
        self.vehicle.autopilot.parameters = _many()
        self.is_far = True
        return self

    def route(self, name: str, publish: Publish) -> None:
        if self.is_far and publish.link == FOG:
            self._air.send(name, publish, self.now_ms, self._rng)
        else:
            super(FarFlight, self).route(name, publish)

    def fly(self, seconds: float) -> None:
        for _ in range(round(seconds * 50)):
            super(FarFlight, self).fly(0.02)
            for name, publish in self._air.arrived(self.now_ms):
                super(FarFlight, self).route(name, publish)

    def carried(self) -> int:
        """Bytes of objects over the radio, and of what asked for them, with all headers."""
        over = [p for who, p in self.sent if p.link == FOG and p.topic.startswith("drone1/bulk")]
        return sum(len(p.payload) + len(p.topic) + HEADERS_BYTES for p in over)


def _many() -> Parameters:
    """As many as the largest autopilots have, of uneven names and values."""
    rng = random.Random(3)
    groups = ["".join(rng.choices("ABCDEFGHIKLMNOPRSTUVXYZ", k=rng.randint(2, 5))) for _ in range(120)]
    words = ["".join(rng.choices("ABCDEFGHIKLMNOPRSTUVXYZ", k=rng.randint(2, 4))) for _ in range(300)]
    specs = dict(SPECS)
    while len(specs) < COUNT:
        default: float | int = rng.randint(0, 300) if rng.random() < 0.5 else round(rng.uniform(-5, 50), 3)
        specs[f"{rng.choice(groups)}_{rng.choice(words)}_{rng.choice(words)}"] = Spec(default, -1e6, 1e6)
    return BytewiseParameters(specs)


def fetch(flight: RadioFlight, base: ParameterSet | None = None) -> tuple[ParameterSet, float, int]:
    """What the drone gives, in how many seconds, with how many bytes over the radio."""
    flight.sent.clear()
    begun_ms = flight.now_ms
    fetching = Fetching(flight.gs.fog(1), 1, PARAMETERS, base.hash if base is not None else None)
    flight.run("gs", flight.gs.transfers.begin(fetching, flight.now_ms))
    while not fetching.is_over:
        flight.fly(0.1)
        assert flight.now_ms - begun_ms < 1000 * MOST_S
    assert fetching.error is None
    assert base is not None or fetching.data
    found = ParameterSet.unpacked(fetching.data, base) if fetching.data else base
    assert found is not None
    return found, (flight.now_ms - begun_ms) / 1000, flight.carried()


def test_a_first_reading_and_what_follows_over_a_radio(capsys: pytest.CaptureFixture[str]) -> None:
    flight = RadioFlight().begin("px4")
    flight.fly(20)
    whole, first_s, first_bytes = fetch(flight)
    assert len(whole) == COUNT
    flight.fly(5)
    same, unchanged_s, unchanged_bytes = fetch(flight, whole)
    assert same == whole
    assert len([p for who, p in flight.sent if who == "uav" and p.topic == "drone1/bulk_answer"]) == 1
    assert flight.outcome(SetParameter("MPC_XY_CRUISE", 7.5)) == (Word.COMPLETED, None)
    after, changed_s, changed_bytes = fetch(flight, whole)
    assert after.parameters["MPC_XY_CRUISE"].value == 7.5
    with capsys.disabled():
        print(
            f"\n{COUNT} parameters over sik: {len(whole.packed())} bytes compressed; first {first_s:.1f} s, "
            f"{first_bytes} bytes; unchanged {unchanged_s:.1f} s, {unchanged_bytes} bytes; one changed "
            f"{changed_s:.1f} s, {changed_bytes} bytes"
        )
