"""1,400 parameters of each drone over a telemetry radio (profile `sik`): 64 kbit/s for both directions, 1 % loss."""

from __future__ import annotations

import random
from collections.abc import Iterable
from typing import Any

import pytest

from mqttxt.activator.drones import CLOUD, FOG
from mqttxt.activator.role import Activator
from mqttxt.core.effects import Publish, Subscribe
from mqttxt.protocol.commands import SetParameter
from mqttxt.protocol.messages import Word
from mqttxt.protocol.parameters import PARAMETERS, ParameterSet
from mqttxt.station.transfers import Fetching
from sitl.parameters import BytewiseParameters, Parameters, Spec
from sitl.px4.parameters import SPECS
from tests.simulation.far import HEADERS_BYTES, Direction
from tests.simulation.flight import STEP_MS, Flight
from tests.simulation.world import UAV_SESSION

COUNT = 1400
MOST_S = 60


class Member(Flight):
    """A drone of a fleet and its autopilot; the fleet carries what it publishes, and its subscriptions."""

    def __init__(self, fleet: RadioFleet, drone: int) -> None:
        super().__init__(drone=drone)
        self._fleet, self._name = fleet, f"drone{drone}"
        self.uav = self._uav(UAV_SESSION + drone)
        self.have_autopilot("px4")
        self.vehicle.autopilot.parameters = _many(drone)

    def route(self, name: str, publish: Publish) -> None:
        self._fleet.sent.append((self._name, publish))
        self._fleet.route(self._name, publish)

    def _subscribe(self, name: str, effect: Subscribe) -> None:
        self._fleet._subscribe(self._name, effect)

    def step(self, now_ms: int) -> None:
        self.now_ms = now_ms
        self.step_autopilot()
        self.run("uav", self.uav.tick(now_ms))


class RadioFleet(Flight):
    """Drones of one fog behind one radio, whose only channel they and both directions share."""

    def __init__(self, *drones: int) -> None:
        self.drones = drones
        super().__init__()
        self._rng = random.Random(7)
        self._air = Direction(60, 64e3, 0.01)
        self._is_far = False
        self._members = {f"drone{drone}": Member(self, drone) for drone in drones}
        for name, member in self._members.items():
            setattr(self, name, member.uav)
        self.gs.add_fogs([1])
        self.run("activator", self.activator.on_connected(FOG, self.now_ms))
        self.run("activator", self.activator.on_connected(CLOUD, self.now_ms))
        for name, member in self._members.items():
            self.run(name, member.uav.on_connected(FOG, self.now_ms))
        self.run("gs", self.gs.on_connected(CLOUD, self.now_ms))
        self.fly(3)
        self._is_far = True
        self.fly(20)

    def _activator(self, session: int) -> Activator:
        return Activator(1, session, self.settings, drones=self.drones)

    def run(self, name: str, outputs: Iterable[Any]) -> None:
        if name in self._members:
            self._members[name].run("uav", outputs)
        else:
            super().run(name, outputs)

    def route(self, name: str, publish: Publish) -> None:
        if self._is_far and publish.link == FOG:
            self._air.send(name, publish, self.now_ms, self._rng)
        else:
            super().route(name, publish)

    def fly(self, seconds: float) -> None:
        for _ in range(round(seconds * 1000 / STEP_MS)):
            self.now_ms += STEP_MS
            for member in self._members.values():
                member.step(self.now_ms)
            for name in ("activator", "gs"):
                self.run(name, getattr(self, name).tick(self.now_ms))
            for name, publish in self._air.arrived(self.now_ms):
                super().route(name, publish)

    def carried(self) -> int:
        """Bytes of objects over the radio, and of what asked for them, with all headers."""
        over = [p for who, p in self.sent if p.link == FOG and p.topic.split("/")[1].startswith("bulk")]
        return sum(len(p.payload) + len(p.topic) + HEADERS_BYTES for p in over)


def _many(drone: int) -> Parameters:
    """As many as the largest autopilots have, of uneven names and values, of each drone others."""
    rng = random.Random(drone)
    groups = ["".join(rng.choices("ABCDEFGHIKLMNOPRSTUVXYZ", k=rng.randint(2, 5))) for _ in range(120)]
    words = ["".join(rng.choices("ABCDEFGHIKLMNOPRSTUVXYZ", k=rng.randint(2, 4))) for _ in range(300)]
    specs = dict(SPECS)
    while len(specs) < COUNT:
        default: float | int = rng.randint(0, 300) if rng.random() < 0.5 else round(rng.uniform(-5, 50), 3)
        specs[f"{rng.choice(groups)}_{rng.choice(words)}_{rng.choice(words)}"] = Spec(default, -1e6, 1e6)
    return BytewiseParameters(specs)


def fetch(fleet: RadioFleet, base: ParameterSet | None = None) -> tuple[ParameterSet, float, int]:
    """What drone 1 gives, in how many seconds, with how many bytes over the radio."""
    ((found, took_s),) = fetch_all(fleet, base)
    return found, took_s, fleet.carried()


def fetch_all(fleet: RadioFleet, base: ParameterSet | None = None) -> list[tuple[ParameterSet, float]]:
    """What each drone gives, all asked at once, and after how many seconds."""
    fleet.sent.clear()
    begun_ms = fleet.now_ms
    known = None if base is None else base.hash
    asked = [Fetching(fleet.gs.fog(1), drone, PARAMETERS, known) for drone in fleet.drones]
    for fetching in asked:
        fleet.run("gs", fleet.gs.transfers.begin(fetching, fleet.now_ms))
    ended_s: dict[int, float] = {}
    while len(ended_s) < len(asked):
        fleet.fly(0.1)
        ended_s.update(
            {f.drone: (fleet.now_ms - begun_ms) / 1000 for f in asked if f.is_over and f.drone not in ended_s}
        )
        assert fleet.now_ms - begun_ms < 1000 * MOST_S
    return [(_given(fetching, base), ended_s[fetching.drone]) for fetching in asked]


def _given(fetching: Fetching, base: ParameterSet | None) -> ParameterSet:
    assert fetching.error is None
    assert base is not None or fetching.data
    found = ParameterSet.unpacked(fetching.data, base) if fetching.data else base
    assert found is not None
    return found


@pytest.mark.long
def test_a_first_reading_and_what_follows_over_a_radio(capsys: pytest.CaptureFixture[str]) -> None:
    flight = RadioFleet(1)
    whole, first_s, first_bytes = fetch(flight)
    assert len(whole) == COUNT
    flight.fly(5)
    same, unchanged_s, unchanged_bytes = fetch(flight, whole)
    assert same == whole
    assert len([p for who, p in flight.sent if who == "drone1" and p.topic == "drone1/bulk_answer"]) == 1
    assert flight.outcome(SetParameter("MPC_XY_CRUISE", 7.5)) == (Word.COMPLETED, None)
    after, changed_s, changed_bytes = fetch(flight, whole)
    assert after.parameters["MPC_XY_CRUISE"].value == 7.5
    with capsys.disabled():
        print(
            f"\n{COUNT} parameters over sik: {len(whole.packed())} bytes compressed; first {first_s:.1f} s, "
            f"{first_bytes} bytes; unchanged {unchanged_s:.1f} s, {unchanged_bytes} bytes; one changed "
            f"{changed_s:.1f} s, {changed_bytes} bytes"
        )


@pytest.mark.long
def test_six_drones_first_readings_share_a_radio(capsys: pytest.CaptureFixture[str]) -> None:
    """`sik` has a radio for each drone; here all six have one, which is worse."""
    fleet = RadioFleet(*range(1, 7))
    read = fetch_all(fleet)
    assert [len(found) for found, _ in read] == [COUNT] * 6
    assert len({found.hash for found, _ in read}) == 6
    with capsys.disabled():
        print(
            f"\n{COUNT} parameters of each of six drones over one radio: {max(s for _, s in read):.1f} s, "
            f"{fleet.carried()} bytes"
        )
