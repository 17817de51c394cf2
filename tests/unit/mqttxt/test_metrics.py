"""What a station knows as Prometheus metrics, and the dashboard that shows them (docs/metrics.md)."""

from __future__ import annotations

import asyncio
import http.client
import json
import re
import socket
import urllib.request
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import pytest
from prometheus_client import start_http_server
from prometheus_client.parser import text_string_to_metric_families

from mqttxt import (
    STATES,
    AutopilotText,
    Battery,
    FlightMode,
    FlightModeName,
    Fog,
    Gps,
    GpsFix,
    Health,
    KnownState,
    Location,
    MavlinkState,
    Ranked,
    SensorReading,
    Severity,
    State,
    metrics,
)
from mqttxt.core.floods import MOST_READINGS
from mqttxt.errors import ConfigurationError
from mqttxt.metrics import _WORDS, FleetCollector, serve
from mqttxt.protocol.state_fields import fields_of
from tests.rigs.loopback import free_port

DASHBOARD = Path(__file__).resolve().parents[3] / "docs" / "grafana" / "fleet.json"


@dataclass
class FakeDrone:
    number: int
    is_reachable: bool = True
    holder: str | None = None
    states: dict[str, KnownState[State]] = field(default_factory=dict)
    readings: list[SensorReading] = field(default_factory=list)


@dataclass
class FakeFog:
    number: int
    drones: list[FakeDrone]
    is_live: bool = True
    ranking: tuple[Ranked, ...] = ()
    fleet: str = ""


def known(*states: State, age_ms: int | None = 1500) -> dict[str, KnownState[State]]:
    return {state.name: KnownState(state, age_ms) for state in states}


async def scraped(*fogs: FakeFog) -> dict[tuple[str, tuple[tuple[str, str], ...]], float]:
    """Every sample by its name and labels, as Prometheus reads them."""
    port = free_port()
    serve(cast("list[Fog]", list(fogs)), "127.0.0.1", port)

    def read() -> str:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=10) as answer:
            return str(answer.read().decode())

    text = await asyncio.to_thread(read)
    samples = [sample for family in text_string_to_metric_families(text) for sample in family.samples]
    return {(sample.name, tuple(sorted(sample.labels.items()))): sample.value for sample in samples}


def of(drone: int, **labels: str) -> tuple[tuple[str, str], ...]:
    return tuple(sorted({"fog": "1", "drone": str(drone), **labels}.items()))


async def test_what_is_known_is_measured_and_what_is_not_has_no_sample() -> None:
    reading = SensorReading(1, 2, 4, 9, 1, "temperature", 21.5, "°C", 1_767_225_600_000)
    flying = FakeDrone(2, holder="gs-ops", readings=[reading])
    flying.states = known(
        Battery(87),
        Location(47.397742, 8.545594, 498.0, 10.0),
        FlightMode(FlightModeName.HOLD),
        Gps(GpsFix.FIX_3D, 12),
        Health(False, 4),
        AutopilotText(Severity.INFO, "hello"),
        MavlinkState("mavlink/ATTITUDE", {"roll": 0.1}),
    )
    gone = FakeDrone(3, is_reachable=False, states=known(Battery(10)))
    ranking = (Ranked(drone=2, remaining_pct=87, max_groundspeed_m_s=12.0, age_s=1.0),)
    found = await scraped(FakeFog(1, [flying, gone], ranking=ranking))
    assert found == {
        ("mqttxt_fog_live", (("fog", "1"),)): 1,
        ("mqttxt_drone_reachable", of(2)): 1,
        ("mqttxt_drone_reachable", of(3)): 0,
        ("mqttxt_drone_controlled", of(2)): 1,
        ("mqttxt_drone_controlled", of(3)): 0,
        ("mqttxt_drone_rank", of(2)): 1,
        ("mqttxt_battery_remaining_pct", of(2)): 87,
        ("mqttxt_location_latitude_deg", of(2)): 47.397742,
        ("mqttxt_location_longitude_deg", of(2)): 8.545594,
        ("mqttxt_location_altitude_amsl_m", of(2)): 498,
        ("mqttxt_location_altitude_m", of(2)): 10,
        ("mqttxt_flight_mode", of(2, mode="hold")): 1,
        ("mqttxt_gps_fix", of(2, fix="fix_3d")): 1,
        ("mqttxt_gps_satellites", of(2)): 12,
        ("mqttxt_health_armable", of(2)): 0,
        ("mqttxt_health_unhealthy_sensors", of(2)): 4,
        **{
            ("mqttxt_state_age_seconds", of(2, state=name)): 1.5
            for name in ("battery", "location", "flight_mode", "gps", "health")
        },
        ("mqttxt_sensor_reading", of(2, sensor="4", kind="temperature", unit="°C")): 21.5,
        ("mqttxt_sensor_reading_time_seconds", of(2, sensor="4", kind="temperature")): 1_767_225_600,
    }


async def test_drones_of_several_fleets_are_told_apart() -> None:
    found = await scraped(FakeFog(1, [FakeDrone(2)], fleet="acme"), FakeFog(1, [FakeDrone(2, False)], fleet="acme/eu"))
    assert found["mqttxt_drone_reachable", of(2, fleet="acme")] == 1
    assert found["mqttxt_drone_reachable", of(2, fleet="acme/eu")] == 0
    assert found["mqttxt_fog_live", (("fleet", "acme"), ("fog", "1"))] == 1


async def test_an_age_that_is_not_known_has_no_sample() -> None:
    found = await scraped(FakeFog(1, [FakeDrone(2, states=known(Battery(87), age_ms=None))], is_live=False))
    assert ("mqttxt_battery_remaining_pct", of(2)) in found
    assert not [name for name, _ in found if name == "mqttxt_state_age_seconds"]
    assert found["mqttxt_fog_live", (("fog", "1"),)] == 0


async def test_a_port_that_is_taken_is_one_line() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(ConfigurationError, match=f"^--listen 127.0.0.1:{port}: cannot listen: "):
            serve([], "127.0.0.1", port)


async def test_an_address_of_ipv6_is_named_as_it_is_typed() -> None:
    with pytest.raises(ConfigurationError, match=r"^--listen \[::1%nowhere\]:9464: cannot listen: "):
        serve([], "::1%nowhere", 9464)


@pytest.mark.parametrize(
    ("host", "status"),
    [
        *(("127.0.0.1:9464", 200), ("localhost", 200), ("[::1]:80", 200)),
        *(("evil.example", 403), ("127.0.0.1.evil.example:9464", 403), ("[", 403), ("", 403)),
    ],
)
async def test_another_name_for_this_address_is_refused(host: str, status: int) -> None:
    port = free_port()
    serve([], "127.0.0.1", port)

    def answered() -> int:
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
        connection.request("GET", "/metrics", headers={"Host": host})
        return connection.getresponse().status

    assert await asyncio.to_thread(answered) == status


async def test_a_sensor_that_makes_up_kinds_makes_no_series_without_end() -> None:
    drone = FakeDrone(2)
    collector = FleetCollector(cast("list[Fog]", [FakeFog(1, [drone])]), asyncio.get_running_loop())
    found: set[tuple[str, ...]] = set()
    for first in range(0, 300, 50):
        kinds = [f"kind{number}" for number in range(first, first + 50)]
        drone.readings = [SensorReading(1, 2, 4, 1, 1, kind, 1.5, "", 1000) for kind in kinds]
        metrics = await asyncio.to_thread(lambda: list(collector.collect()))
        found |= {tuple(s.labels.values()) for m in metrics for s in m.samples if m.name == "mqttxt_sensor_reading"}
    assert len(found) == MOST_READINGS


def test_no_two_states_share_a_metric() -> None:
    names = [f"mqttxt_{alone}" for state in STATES for alone in fields_of(state).values()]
    assert len(set(names)) == len(names)
    assert not set(names) & set(_WORDS)


def test_the_dashboard_shows_metrics_that_there_are() -> None:
    dashboard: dict[str, Any] = json.loads(DASHBOARD.read_text(encoding="utf-8"))
    asked = [target["expr"] for panel in dashboard["panels"] for target in panel["targets"]]
    shown = {name for expression in asked for name in re.findall(r"mqttxt_\w+", expression)}
    assert shown
    assert shown <= {*_WORDS, *(f"mqttxt_{alone}" for state in STATES for alone in fields_of(state).values())}
    assert len({panel["id"] for panel in dashboard["panels"]}) == len(dashboard["panels"])


async def test_before_its_guard_is_there_it_answers_with_no_sample(monkeypatch: pytest.MonkeyPatch) -> None:
    """It listens from the moment of its start on, and a page of another name may ask at once."""
    port, texts = free_port(), []

    def started(*arguments: Any) -> Any:
        found = start_http_server(*arguments)
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=10) as answer:
            texts.append(answer.read())
        return found

    monkeypatch.setattr(metrics, "start_http_server", started)
    serve([], "127.0.0.1", port)
    assert texts == [b""]
