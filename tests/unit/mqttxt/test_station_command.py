"""A subcommand for one drone waits until its station controls it, unless another station does."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import pytest
import typer
from typer.testing import CliRunner

from mqttxt import Drone
from mqttxt.cli import station
from mqttxt.cli.main import app
from mqttxt.cli.station import DroneOptions, StationOptions
from mqttxt.core.clock import SessionClock
from mqttxt.core.effects import Inbound, Subscribe
from mqttxt.core.settings import Settings
from mqttxt.protocol.codec import decode, encode
from mqttxt.protocol.control import DroneRecord, Registration
from mqttxt.protocol.messages import BeaconMessage, FogPresence
from mqttxt.station.process import StationRunner
from mqttxt.station.role import StationRole
from tests.simulation.fogs import of

OWN, OTHER, FOG, BEFORE = 0x11, 0x77, 0x22, 0x21


def record(holder: str | None = None, session: int | None = None, fog: int = FOG) -> DroneRecord:
    return DroneRecord(activator_session=fog, up=True, drone_session=5, holder=holder, holder_session=session, epoch=1)


class Station:
    """An entered station with one fog, which says the test's records of drone 1 one after another while it waits."""

    name, fleet = "gs-own", ""
    clock = SessionClock(lambda: 0)

    def __init__(self, *records: DroneRecord) -> None:
        self.records = [*records]
        self.role = StationRole(self.name, OWN, Settings())
        self.station = self.role
        self.role.add_fogs([1])
        for effect in self.role.on_connected("cloud", 0):
            if isinstance(effect, Subscribe):
                self.role.on_subscribed(effect, 0)
        (registration,) = of(self.hear("reachable", FogPresence(session=FOG, up=True)), "fog1/init_connect")
        nonce = decode(Registration, registration.payload).nonce
        self.hear("clock", BeaconMessage(session=FOG, now_ms=0, nonce=nonce, held_ms=0))
        self.next_record()

    def hear(self, rest: str, message: Any) -> list[Any]:
        return list(self.role.on_message("cloud", Inbound(f"fog1/{rest}", encode(message), 1), 0))

    def next_record(self) -> None:
        self.hear("drone1/reachable", self.records.pop(0))

    def drone(self, number: int) -> Drone:
        return Drone(cast(StationRunner, self), self.role.fog(1), number)

    async def wait_until(self, condition: Callable[[], bool], _: float) -> None:
        while not condition():
            if not self.records:
                raise TimeoutError
            self.next_record()

    async def __aenter__(self) -> Station:
        return self

    async def __aexit__(self, *_: object) -> None:
        pass


@pytest.fixture
def at(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Station]:
    """Makes the station of the next subcommand."""

    def make(*records: DroneRecord) -> Station:
        made = Station(*records)

        async def connected(*_: object) -> list[Station]:
            return [made]

        monkeypatch.setattr(StationOptions, "station", lambda *_: made)
        monkeypatch.setattr(station, "connect", connected)
        return made

    return make


@pytest.mark.parametrize("typed", [["params", "list"], ["logs", "list"], ["plan", "download", "new.plan"]])
def test_a_drone_of_another_station_is_an_error_at_once(typed: list[str], at: Callable[..., Station]) -> None:
    mine = record("gs-own", OWN)
    there = at(record("gs-x", OTHER), mine)
    done = CliRunner().invoke(app, ["gs", *typed, "--drone", "1"])
    said = "drone 1: expected this station in control, not gs-x; --take-over takes control from it"
    assert (done.exit_code, done.stderr) == (2, f"mqttxt: {said}\n")
    assert there.records == [mine]  # it did not wait for that


@pytest.mark.parametrize(
    "before",
    [
        pytest.param([record()], id="nobody has it"),
        pytest.param([record("gs-x", OTHER, fog=BEFORE)], id="a record of the activator's session before"),
        pytest.param([record("gs-own", OTHER)], id="its own name, of a session before"),
        pytest.param([record(), record()], id="nobody has it, twice"),
    ],
)
def test_control_that_comes_a_moment_later_is_waited_for(before: list[DroneRecord], at: Callable[..., Station]) -> None:
    at(*before, record("gs-own", OWN))
    found: list[bool] = []

    async def job(there: Drone) -> int:
        found.append(there.is_controlled)
        return 0

    with pytest.raises(typer.Exit) as ended:
        station.run_with_drone(job, DroneOptions("1"), StationOptions())
    assert (ended.value.exit_code, found) == (0, [True])


def test_a_drone_that_nobody_has_when_the_wait_ends_advises_no_takeover(at: Callable[..., Station]) -> None:
    at(record())
    done = CliRunner().invoke(app, ["gs", "params", "list", "--drone", "1"])
    assert done.stderr == "mqttxt: drone 1: expected this station in control, not nobody\n"
