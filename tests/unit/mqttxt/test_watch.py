"""The table of `mqttxt gs watch`."""

from __future__ import annotations

from typing import cast

import pytest

from mqttxt import Heading, KnownState, Location, State
from mqttxt.cli.watch import table
from mqttxt.station.views import Fog
from tests.simulation.page_fleet import FakeDrone, FakeStation


class WatchedDrone(FakeDrone):
    """With the parts of `Drone` that the table reads."""

    def state(self, kind: type[State]) -> KnownState[State] | None:
        return self.states.get(kind.name)

    @property
    def location(self) -> KnownState[State] | None:
        return self.state(Location)


def cells(*states: State) -> dict[str, str]:
    """The row of one drone, by the headings."""
    fog = FakeStation().the_fog
    drone = WatchedDrone(1, FakeStation())
    drone.set(*states)
    fog.drones = [drone]
    shown = table([cast(Fog, fog)])
    return {str(column.header): str(next(iter(column.cells))) for column in shown.columns}


@pytest.mark.parametrize(
    ("altitude_m", "said"), [(-0.04, "0.0"), (-0.0, "0.0"), (-0.06, "-0.1"), (0.04, "0.0"), (12.36, "12.4")]
)
def test_an_altitude_of_nothing_has_no_sign(altitude_m: float, said: str) -> None:
    assert cells(Location(47.0, 8.0, 498.0, altitude_m))["altitude m"] == said


def test_a_position_of_nothing_has_no_sign() -> None:
    assert cells(Location(-0.000001, -8.25, 498.0, 1.0))["position"] == "0.00000 -8.25000"


@pytest.mark.parametrize(("heading_deg", "said"), [(359.6, "0"), (359.4, "359"), (0.2, "0"), (90.0, "90")])
def test_a_heading_is_below_360(heading_deg: float, said: str) -> None:
    assert cells(Heading(heading_deg))["heading"] == said
