"""What a station knows as Home Assistant's devices (docs/homeassistant.md)."""

from __future__ import annotations

import asyncio
import json
import re
from typing import Any, cast

import pytest

from mqttxt import Armed, Battery, FlightMode, FlightModeName, Fog, Gps, Location, SensorReading, homeassistant
from mqttxt.core.address import BrokerAddress
from mqttxt.core.effects import Publish, Will
from mqttxt.core.floods import MOST_READINGS
from mqttxt.homeassistant import Entities, HomeAssistant
from mqttxt.station.views import STALE_MS
from tests.rigs.processes import eventually
from tests.unit.mqttxt.test_metrics import FakeDrone, FakeFog, known
from tests.unit.mqttxt.typed import refused

FLYING = known(Battery(81), Location(47.4, 8.5, 500.0, 12.0), FlightMode(FlightModeName.HOLD))


def shown(*drones: FakeDrone, is_live: bool = True) -> dict[str, Any]:
    """Every message by its topic, JSON read."""
    fog = FakeFog(1, list(drones), is_live)
    found = dict(Entities(cast("list[Fog]", [fog])).messages())
    return {topic: json.loads(text) if text[0] == "{" else text for topic, text in found.items()}


def entity(found: dict[str, Any], component: str, key: str, node: str = "drone2") -> Any:
    return found[f"homeassistant/{component}/mqttxt_{node}_{key}/config"]


def test_each_field_of_a_state_is_an_entity_of_its_drone() -> None:
    found = shown(FakeDrone(2, states=FLYING))
    battery = entity(found, "sensor", "battery_remaining_pct")
    assert (battery["unit_of_measurement"], battery["device_class"]) == ("%", "battery")
    assert battery["value_template"] == "{{ value_json['battery_remaining_pct'] }}"
    assert battery["device"]["identifiers"] == ["mqttxt_drone2"]
    assert entity(found, "sensor", "location_altitude_m")["unit_of_measurement"] == "m"
    assert "hold" in entity(found, "sensor", "flight_mode")["options"]
    values = found[battery["state_topic"]]
    assert (values["battery_remaining_pct"], values["flight_mode"], values["latitude"]) == (81, "hold", 47.4)
    assert (values["reachable"], values["controlled_by"]) == (True, "nobody")


def test_an_entitys_name_is_without_its_unit() -> None:
    found = shown(FakeDrone(2, states=FLYING))
    keys = ("battery_remaining_pct", "location_altitude_m", "location_altitude_amsl_m", "flight_mode", "latitude")
    assert [entity(found, "sensor", key)["name"] for key in keys] == [
        *("Battery remaining", "Location altitude", "Location altitude amsl", "Flight mode", "Latitude")
    ]


def test_what_is_not_known_any_more_has_no_value_in_place_of_the_last() -> None:
    found = [shown(FakeDrone(2, states=known(Gps(3, satellites)))) for satellites in (12, None)]
    assert [each["mqttxt/drone2/state"]["gps_satellites"] for each in found] == [12, None]
    topic = "homeassistant/sensor/mqttxt_drone2_gps_satellites/config"
    assert [topic in each for each in found] == [True, False], "what was never known is no entity"


def test_a_value_that_is_too_old_to_be_of_now_is_unknown() -> None:
    """A UAV client whose autopilot is dead is reachable, and its last states would stand as those of now."""
    young, old, unaged = (
        known(Armed(True), FlightMode(FlightModeName.HOLD), age_ms=age_ms) for age_ms in (STALE_MS, STALE_MS + 1, None)
    )
    entities = Entities(cast("list[Fog]", [FakeFog(1, [drone := FakeDrone(2, states=young)])]))
    values = []
    for drone.states in (young, old, unaged):
        found = json.loads(dict(entities.messages())["mqttxt/drone2/state"])
        values.append((found["reachable"], found["armed"], found["flight_mode"]))
    assert values == [(True, True, "hold"), (True, None, None), (True, True, "hold")]


def test_a_readings_name_is_no_calculation() -> None:
    """In a template `a-1` is one less than `a`, and Home Assistant takes no entity with a dot in its name."""
    kinds = ("air", "air-1", "air.pressure", "air-2e-pressure")
    given = [SensorReading(1, 2, 7, 1, 1, kind, float(place), "", 0) for place, kind in enumerate(kinds)]
    found = shown(FakeDrone(2, readings=given))
    configs = {topic: config for topic, config in found.items() if "_sensor7_" in topic}
    keys = [re.fullmatch(r"\{\{ value_json\['(.*)'\] \}\}", config["value_template"]) for config in configs.values()]
    assert [found["mqttxt/drone2/state"][key[1]] for key in keys if key is not None] == [0, 1, 2, 3]
    assert all(re.fullmatch(r"homeassistant/sensor/[A-Za-z0-9_-]+/config", topic) for topic in configs)
    assert len({config["unique_id"] for config in configs.values()}) == len(kinds)


def test_a_place_is_a_device_on_the_map() -> None:
    tracker = entity(shown(FakeDrone(2, states=FLYING)), "device_tracker", "location")
    assert (tracker["source_type"], tracker["json_attributes_topic"]) == ("gps", "mqttxt/drone2/state")
    assert not [topic for topic in shown(FakeDrone(2)) if "device_tracker" in topic]


@pytest.mark.parametrize(("is_reachable", "is_live"), [(True, True), (False, True), (True, False)])
def test_what_a_drone_said_that_is_gone_is_not_available(is_reachable: bool, is_live: bool) -> None:
    found = shown(FakeDrone(2, is_reachable=is_reachable, states=FLYING), is_live=is_live)
    topics = [each["topic"] for each in entity(found, "sensor", "flight_mode")["availability"]]
    assert topics == ["mqttxt/fogs-1/status", "mqttxt/drone2/available"]
    assert found["mqttxt/drone2/available"] == ("online" if is_reachable and is_live else "offline")
    always = entity(found, "binary_sensor", "reachable")["availability"]
    assert always == [{"topic": "mqttxt/fogs-1/status"}]


def test_a_reading_is_an_entity_with_its_unit() -> None:
    given = [
        SensorReading(1, 2, 7, 1, 1, kind, value, unit, 0)
        for kind, value, unit in (("temperature", 21.5, "degC"), ("humidity", 40.0, "%"), ("wind", 3.0, "m/s"))
    ]
    found = shown(FakeDrone(2, readings=given))
    warm, wet, wind = (entity(found, "sensor", f"sensor7_{kind}") for kind in ("temperature", "humidity", "wind"))
    assert (warm["unit_of_measurement"], warm["device_class"]) == ("°C", "temperature")
    assert (wet["device_class"], wind["unit_of_measurement"]) == ("humidity", "m/s")
    assert found["mqttxt/drone2/state"]["sensor7_wind"] == 3.0


class Link:
    """A connection that is up as long as it runs, and remembers what was published."""

    def __init__(self, _name: str, address: BrokerAddress, _client_id: str, will: Any, events: HomeAssistant) -> None:
        self.address, self.will, self.events = address, will, events
        self.said: list[tuple[str, str]] = []
        self.is_closed = False
        LINKS.append(self)

    async def run(self) -> None:
        self.events.connected("broker")
        await asyncio.Event().wait()

    def publish(self, effect: Publish) -> None:
        assert (effect.qos, effect.retain, self.is_closed) == (1, True, False)
        self.said.append((effect.topic, effect.payload.decode()))

    async def close(self) -> None:
        self.is_closed = True


LINKS: list[Link] = []


async def test_what_has_changed_is_published_and_the_end_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(homeassistant, "MqttLink", Link)
    monkeypatch.setattr(homeassistant, "INTERVAL_S", 0.01)
    drone = FakeDrone(2, states=FLYING)
    entities = Entities(cast("list[Fog]", [FakeFog(1, [drone])]))
    address = BrokerAddress("127.0.0.1", 1883)
    running = asyncio.create_task(HomeAssistant(address, entities).run())
    await eventually(lambda: LINKS and LINKS[-1].said, "it is connected")
    link = LINKS.pop()
    assert link.will() == Will("mqttxt/fogs-1/status", b"offline")
    assert link.said == [("mqttxt/fogs-1/status", "online"), *entities.messages()]
    link.said.clear()
    drone.is_reachable = False
    await eventually(lambda: len(link.said) >= 2, "the change is published")
    assert [topic for topic, _ in link.said] == ["mqttxt/drone2/state", "mqttxt/drone2/available"]
    link.events.connected("broker")
    assert link.said[2:] == [("mqttxt/fogs-1/status", "online"), *entities.messages()]
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)
    assert link.said[-1] == ("mqttxt/fogs-1/status", "offline")
    assert link.is_closed


def test_an_open_broker_elsewhere_has_to_be_asked_for() -> None:
    said = refused("gs", "homeassistant", "--fog", "1", "--broker", "mqtt://ha.example")
    assert said == "--broker mqtt://ha.example:1883: not encrypted; expected mqtts://, or --insecure-broker"


def test_a_sensor_that_makes_up_kinds_makes_no_entities_without_end() -> None:
    entities = Entities(cast("list[Fog]", [FakeFog(1, [drone := FakeDrone(2)])]))
    topics: set[str] = set()
    for first in range(0, 300, 50):
        kinds = [f"kind{number:03}" for number in range(first, first + 50)]
        drone.readings = [SensorReading(1, 2, 4, 1, 1, kind, 1.5, "", 1000) for kind in kinds]
        topics |= {topic for topic, _ in entities.messages() if "_sensor4_" in topic}
    assert len(topics) == MOST_READINGS
    drone.readings = [SensorReading(1, 2, 4, 1, 1, "kind000", 2.5, "", 2000)]
    assert json.loads(dict(entities.messages())["mqttxt/drone2/state"])["sensor4_kind000"] == 2.5


@pytest.mark.parametrize("new", [0, 1])
def test_a_drone_that_two_fogs_know_is_as_the_one_sees_it_that_reaches_it(new: int) -> None:
    """Else the device would come and go each second, and end with whatever the last fog says."""
    here, gone = FakeDrone(2, states=known(Battery(60))), FakeDrone(2, is_reachable=False, states=known(Battery(90)))
    fogs = [FakeFog(1, [gone]), FakeFog(2, [gone])]
    fogs[new] = FakeFog(new + 1, [here])
    found = list(Entities(cast("list[Fog]", fogs)).messages())
    assert len(found) == len(dict(found)), "one payload for each topic"
    assert json.loads(dict(found)["mqttxt/drone2/state"])["battery_remaining_pct"] == 60
    assert dict(found)["mqttxt/drone2/available"] == "online"


def test_drones_of_several_fleets_are_devices_of_their_own() -> None:
    fleets = ("acme/eu", "acme_eu", "acme-eu", "acme-2f-eu", "münchen")
    fogs = [FakeFog(1, [FakeDrone(2, states=FLYING)], fleet=fleet) for fleet in fleets]
    found = dict(Entities(cast("list[Fog]", fogs)).messages())
    assert len(found) == len(fleets) * len(dict(Entities(cast("list[Fog]", fogs[:1])).messages()))
    assert "mqttxt/acme-2f-eu_drone2/state" in found
    names = [topic.split("/")[2] for topic in found if topic.startswith("homeassistant/")]
    assert [name for name in names if not re.fullmatch(r"[A-Za-z0-9_-]+", name)] == []
