"""What a caller gets wrong is refused where it is said, with the field, the value and what was expected."""

from __future__ import annotations

from typing import Any
from unittest.mock import patch

import pytest

from mqttxt.activator.leases import MAX_EPOCH, Leases
from mqttxt.errors import ConfigurationError, MqttxtError, PayloadError
from mqttxt.protocol.commands import Attitude, Goto, Offboard, SetParameter, Takeoff, Velocity
from mqttxt.protocol.control import Control, Registration
from mqttxt.protocol.values import Encoding
from mqttxt.station.commands import ttl_ms_of
from tests.simulation.world import World

NAN, INFINITE = float("nan"), float("inf")


@pytest.mark.parametrize(
    ("command", "field"),
    [
        (Goto(NAN, 8.0, 10.0), "latitude_deg"),
        (Goto(91.0, 8.0, 10.0), "latitude_deg"),
        (Goto(47.0, -180.1, 10.0), "longitude_deg"),
        (Goto(47.0, 8.0, INFINITE), "altitude_m"),
        (Goto(47.0, 8.0, -501.0), "altitude_m"),
        (Takeoff(altitude_m=NAN), "altitude_m"),
        (Takeoff(altitude_m=0.4), "altitude_m"),
        (Takeoff(altitude_m="10"), "altitude_m"),  # type: ignore[arg-type]
        (Offboard(NAN, velocity=Velocity(1, 0, 0)), "limit_s"),
        (Offboard(0.0, velocity=Velocity(1, 0, 0)), "duration_s"),
        (Offboard(5.0, velocity=Velocity(NAN, 0, 0)), "north_m_s"),
        (Offboard(5.0, attitude=Attitude(0, 0, 0, 1.1)), "thrust"),
    ],
)
def test_a_command_that_cannot_be_is_not_sent_and_its_field_is_named(command: Any, field: str) -> None:
    world = World().start()
    sent = len(world.sent)
    with pytest.raises(PayloadError, match=rf"^{field}: expected a number from .* to .*, got "):
        world.send(command)
    assert len(world.sent) == sent


@pytest.mark.parametrize("encoding", Encoding)
@pytest.mark.parametrize("name", ["MPC_Z_VEL_MAX_UPX", "", "MPC Z", "\u00fc", None])
def test_a_parameter_whose_name_cannot_be_is_not_sent_as_another_one(name: Any, encoding: Encoding) -> None:
    """Cut to 16 characters, MPC_Z_VEL_MAX_UPX would set MPC_Z_VEL_MAX_UP."""
    world = World(encoding=encoding).start()
    sent = len(world.sent)
    with pytest.raises(PayloadError, match=r"^parameter: expected "):
        world.send(SetParameter(name, 3.0))
    assert len(world.sent) == sent


@pytest.mark.parametrize("limit_s", [NAN, INFINITE, -1.0, 0.0, 86_401.0])
def test_a_limit_that_cannot_be_is_named(limit_s: float) -> None:
    with pytest.raises(ConfigurationError, match=r"limit .* s: expected 0\.1 to 86400"):
        World().start().send(Takeoff(), limit_s=limit_s)


@pytest.mark.parametrize("ttl_s", [NAN, INFINITE, -1.0, 0.0, 60.1])
def test_a_ttl_that_cannot_be_is_named(ttl_s: float) -> None:
    with pytest.raises(ConfigurationError, match=r"ttl .* s: expected more than 0 and at most 60"):
        ttl_ms_of(ttl_s)


def test_the_shortest_ttl_is_a_millisecond() -> None:
    assert (ttl_ms_of(1e-9), ttl_ms_of(60)) == (1, 60_000)


def test_after_the_last_epoch_nobody_takes_over() -> None:
    """A record that claims it would otherwise make the next one uncarriable."""
    leases = Leases([1])
    leases.register(Registration(name="a", session=1, nonce=1, lease_s=30, control=Control.WANT), 0)
    leases.restore(1, None, MAX_EPOCH, 0)
    taker = Registration(name="b", session=2, nonce=1, lease_s=30, control=Control.TAKE, epoch=MAX_EPOCH)
    assert leases.register(taker, 0) == set()
    assert leases.epoch(1) == MAX_EPOCH
    holder = leases.holder(1)
    assert holder is not None
    assert holder.key == ("a", 1)


def test_a_clock_that_jumps_ahead_lets_nothing_run_late() -> None:
    """As after a suspend: what was on its way has expired, and the world goes on."""
    world = World().start()
    with patch.object(world, "route", lambda *_: None):
        world.send(Takeoff(altitude_m=10))
    (command,) = [publish for _, publish in world.sent if publish.topic == "fog1/drone1/commands"]
    world.now_ms += 3_600_000
    world.route("gs", command)
    world.pass_time(1000)
    assert world.wrote == []
    assert not world.stops
    try:
        world.send(Takeoff(altitude_m=10))
    except MqttxtError as refusal:
        pytest.fail(str(refusal))
