"""PX4's modes: names and numbers are each other's inverse."""

from __future__ import annotations

import pytest

from mqttxt.drone.mavlink.px4 import mode_name, mode_numbers
from mqttxt.protocol.states import FlightModeName


@pytest.mark.parametrize("name", [name for name in FlightModeName if 0 < name.value < FlightModeName.GUIDED.value])
def test_every_mode_has_numbers_that_name_it(name: FlightModeName) -> None:
    main, sub = mode_numbers(name)
    assert mode_name(main << 16 | sub << 24) is name


@pytest.mark.parametrize(
    ("custom_mode", "name"),
    [
        (0x03040000, FlightModeName.HOLD),
        (0x05040000, FlightModeName.RETURN),
        (0x06040000, FlightModeName.LAND),
        (0x00060000, FlightModeName.OFFBOARD),
        (0x00630000, FlightModeName.UNKNOWN),
        (0, FlightModeName.UNKNOWN),
    ],
)
def test_known_numbers(custom_mode: int, name: FlightModeName) -> None:
    assert mode_name(custom_mode) is name


def test_unknown_has_no_numbers() -> None:
    with pytest.raises(KeyError):
        mode_numbers(FlightModeName.UNKNOWN)
