"""A drone to test: messages in, messages and events out, at simulated times."""

from __future__ import annotations

from collections.abc import Callable
from itertools import groupby
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from sitl.ardupilot.personality import ARDUCOPTER
from sitl.fleet import DroneConfig
from sitl.outputs import Happened, Reply
from sitl.personality import Personality
from sitl.px4.personality import PX4
from sitl.vehicle import Vehicle

NAN = float("nan")
GCS = (245, 190)


class Drone:
    """A vehicle with one link, flown by a test."""

    like: Personality = PX4

    def __init__(self, **parameters: float) -> None:
        self.vehicle = Vehicle(DroneConfig(1, parameters=parameters, quiet=True), ["px4-onboard"], like=self.like)
        self.out: list[Any] = []

    @property
    def autopilot(self) -> Any:
        return self.vehicle.autopilot

    @property
    def up_m(self) -> float:
        return float(self.autopilot.motion.position[2])

    @property
    def mode(self) -> str:
        return str(self.autopilot.mode.name)

    def fly(self, seconds: float) -> None:
        self.out += self.vehicle.advance(self.autopilot.now_s + seconds)

    def fly_until(self, condition: Callable[[], bool], limit_s: float = 300) -> float:
        """Simulated seconds until the condition holds."""
        start_s = self.autopilot.now_s
        while not condition():
            assert self.autopilot.now_s - start_s < limit_s, "the condition never came true"
            self.fly(0.1)
        return float(self.autopilot.now_s - start_s)

    def tell(self, message: Any) -> list[Any]:
        """The messages that answer one from the ground station, which is packed and parsed as on a wire."""
        packed = message.pack(mavlink.MAVLink(None, *GCS))
        outputs = self.vehicle.handle(0, mavlink.MAVLink(None).parse_buffer(packed)[0])
        self.out += outputs
        return [output.message for output in outputs if isinstance(output, Reply)]

    def command(self, number: int, *params: float, system: int = 1, component: int = 1) -> int | None:
        """COMMAND_LONG; the MAV_RESULT that it ends with, None where nothing answers."""
        seven = [*params, *[0.0] * (7 - len(params))]
        return _result(self.tell(mavlink.MAVLink_command_long_message(system, component, number, 0, *seven)))

    def command_int(
        self, number: int, *params: float, x: int = 0, y: int = 0, z: float = 0, frame: int = 0
    ) -> int | None:
        four = [*params, *[0.0] * (4 - len(params))]
        return _result(self.tell(mavlink.MAVLink_command_int_message(1, 1, frame, number, 0, 0, *four, x, y, z)))

    def reposition(self, north_m: float, east_m: float, z: float = NAN, frame: int = 0) -> int | None:
        """A goto from where it began, at the height that it has unless `z` says another."""
        place = self.autopilot.guidance.origin.offset(north_m, east_m, 0)
        x, y = round(place.latitude_deg * 1e7), round(place.longitude_deg * 1e7)
        return self.command_int(192, -1, 1, 0, NAN, x=x, y=y, z=z, frame=frame)

    def take_off(self, altitude_m: float = 10.0) -> None:
        """Armed and hovering."""
        assert self.command(400, 1) == 0
        assert self.command(22, NAN, 0, 0, NAN, NAN, NAN, self.autopilot.guidance.home.altitude_m + altitude_m) == 0
        self.fly_until(lambda: self.mode == "HOLD" and abs(self.autopilot.motion.velocity[2]) < 0.02)

    @property
    def heartbeat(self) -> Any:
        """The one that it would send now."""
        return self.vehicle.telemetry.make("HEARTBEAT")

    def events(self) -> list[str]:
        return [output.event for output in self.out if isinstance(output, Happened)]

    def sent(self, kind: str) -> list[Any]:
        return [o.message for o in self.out if isinstance(o, Reply) and o.message.get_type() == kind]

    def texts(self) -> list[str]:
        """What it said, the parts of each text together."""
        parts = groupby(self.sent("STATUSTEXT"), lambda message: message.id or message)
        return ["".join(part.text for part in text).rstrip("\t") for _, text in parts]


class Copter(Drone):
    """The same like an ArduCopter."""

    like = ARDUCOPTER

    def take_off(self, altitude_m: float = 10.0) -> None:
        assert self.command(400, 1) == 0
        assert self.command(22, *[0.0] * 6, altitude_m) == 0
        self.fly_until(lambda: self.up_m > altitude_m - 0.5 and abs(self.autopilot.motion.velocity[2]) < 0.02)

    def go(self, north_m: float, east_m: float, up_m: float) -> int | None:
        """A goto as MQTT-XT says it, above mean sea level."""
        home = self.autopilot.guidance.home
        place = home.offset(north_m, east_m, up_m)
        where = {"x": round(place.latitude_deg * 1e7), "y": round(place.longitude_deg * 1e7), "z": place.altitude_m}
        return self.command_int(192, -1, 1, **where)

    def push(self, north: float, east: float, down: float) -> None:
        """One set-point of velocity."""
        velocity = (0, 0, 0, north, east, down, 0, 0, 0, 0, 0)
        self.tell(mavlink.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, 0b1111_1100_0111, *velocity))


def _result(answers: list[Any]) -> int | None:
    acks = [answer for answer in answers if answer.get_type() == "COMMAND_ACK"]
    assert [ack.result for ack in acks[:-1]] in ([], [mavlink.MAV_RESULT_ACCEPTED])
    return int(acks[-1].result) if acks else None


@pytest.fixture
def drone() -> Drone:
    return Drone()


@pytest.fixture
def copter() -> Copter:
    return Copter()


@pytest.fixture
def make_copter() -> type[Copter]:
    return Copter


@pytest.fixture
def make_drone() -> type[Drone]:
    return Drone
