"""How long a client waits for the value that it has set, on links of the profiles in `tc_profiles` (simulated)."""

from __future__ import annotations

import statistics

import pytest

from mqttxt.protocol.commands import SetParameter
from mqttxt.protocol.messages import Word
from tests.simulation.far import FAR_LINKS, Direction, FarFlight, FarLink

pytestmark = pytest.mark.long
SETTINGS = 40
CLIENTS_MS = 3000
"""How long MAVSDK, QGroundControl and pymavlink wait for a PARAM_VALUE, their repetitions included."""


@pytest.mark.parametrize("link", FAR_LINKS, ids=lambda link: link.name)
def test_a_value_is_there_in_time_for_clients(link: FarLink, capsys: pytest.CaptureFixture[str]) -> None:
    flight = FarFlight()
    flight.up, flight.down = (Direction(link.one_way_ms, rate, link.loss) for rate in (256e3, 1e6))
    flight.begin("px4")
    flight.is_far = True
    flight.fly(20)
    waited_ms = []
    for number in range(SETTINGS):
        begun_ms, sent = flight.now_ms, flight.send(SetParameter("MPC_XY_CRUISE", 5.0 + number % 2))
        while (last := flight.last_of(sent)) is None:
            flight.fly(0.02)
        assert last.word is Word.COMPLETED
        waited_ms.append(flight.now_ms - begun_ms)
        flight.fly(1)
    late = sum(waited > CLIENTS_MS for waited in waited_ms)
    assert (late == 0) is link.is_in_time
    with capsys.disabled():
        median_s, longest_s = statistics.median(waited_ms) / 1000, max(waited_ms) / 1000
        print(f"\n{link.name}: median {median_s:.2f} s, longest {longest_s:.2f} s, {late} of {SETTINGS} beyond 3 s")
