"""How long a client waits for its answers on links of the profiles in `tc_profiles` (simulated)."""

from __future__ import annotations

import statistics

import pytest

from mqttxt.protocol.commands import Arm, Hold, Land, SetParameter, Takeoff
from mqttxt.protocol.messages import Word
from mqttxt.station.outcomes import Outcome
from tests.simulation.far import FAR_LINKS, Direction, FarFlight, FarLink

SETTINGS = 40
SETTING_MS = 3000
"""How long MAVSDK, QGroundControl and pymavlink wait for a PARAM_VALUE, their repetitions included."""
COMMAND_MS = 2000
"""How long MAVSDK waits for the first COMMAND_ACK, its repetitions included."""


def far_flight(link: FarLink, loss: float) -> FarFlight:
    flight = FarFlight()
    flight.up, flight.down = (Direction(link.one_way_ms, rate, loss) for rate in (256e3, 1e6))
    flight.begin("px4")
    flight.is_far = True
    flight.fly(20)
    return flight


@pytest.mark.long
@pytest.mark.parametrize("link", FAR_LINKS, ids=lambda link: link.name)
def test_a_value_is_there_in_time_for_clients(link: FarLink, capsys: pytest.CaptureFixture[str]) -> None:
    flight, waited_ms = far_flight(link, link.loss), []
    for number in range(SETTINGS):
        begun_ms, sent = flight.now_ms, flight.send(SetParameter("MPC_XY_CRUISE", 5.0 + number % 2))
        while (last := flight.last_of(sent)) is None:
            flight.fly(0.02)
        assert last.word is Word.COMPLETED
        waited_ms.append(flight.now_ms - begun_ms)
        flight.fly(1)
    late = sum(waited > SETTING_MS for waited in waited_ms)
    assert (late == 0) is link.is_in_time
    with capsys.disabled():
        median_s, longest_s = statistics.median(waited_ms) / 1000, max(waited_ms) / 1000
        print(f"\n{link.name}: median {median_s:.2f} s, longest {longest_s:.2f} s, {late} of {SETTINGS} beyond 3 s")


@pytest.mark.parametrize("link", FAR_LINKS, ids=lambda link: link.name)
def test_a_command_is_accepted_in_time_for_clients_where_nothing_is_lost(link: FarLink) -> None:
    flight, waited_ms = far_flight(link, 0.0), []
    for command in (Arm(), Takeoff(10.0), Hold(), Land()):
        begun_ms, sent = flight.now_ms, flight.send(command)
        while not (words := [one.word for one in flight.heard if isinstance(one, Outcome) and one.id == sent]):
            flight.fly(0.02)
        waited_ms.append(flight.now_ms - begun_ms)
        assert words == [Word.ACCEPTED]
        flight.fly(5)  # a drone that waits for its takeoff disarms by itself
    round_trip_ms = 2 * link.one_way_ms
    assert all(round_trip_ms < waited < round_trip_ms + 200 for waited in waited_ms), waited_ms
    assert all(waited < COMMAND_MS for waited in waited_ms) is link.is_in_time
