"""Drones and sensors as devices of Home Assistant, by its MQTT discovery (docs/homeassistant.md)."""

from __future__ import annotations

import asyncio
import json
import logging
import secrets
from collections.abc import Hashable, Iterator, Sequence
from typing import Any

from .core.address import BrokerAddress
from .core.effects import Inbound, Publish, Subscribe, Will
from .core.floods import FirstReadings
from .core.mqtt.link import MqttLink
from .protocol.fields import Named
from .protocol.state_fields import fields_of
from .protocol.states import STATES, AutopilotText
from .station.outcomes import SensorReading
from .station.views import STALE_MS, Drone, Fog

logger = logging.getLogger("mqttxt")

LINK = "Home Assistant"
INTERVAL_S = 1.0
"""Shortest time between two publications of changes."""
ONLINE, OFFLINE = "online", "offline"
NOBODY = "nobody"
_UNITS = {
    "_pct": ("%", None),
    "_m_s": ("m/s", "speed"),
    "_deg": ("°", None),
    "_m": ("m", "distance"),
    "_s": ("s", "duration"),
    "_v": ("V", "voltage"),
    "_a": ("A", "current"),
}
"""Unit and Home Assistant's device class by the end of a field's name; of `_m` and `_s` the longer one comes first."""
_KINDS = {"degC": ("°C", "temperature"), "%": ("%", None), "lx": ("lx", "illuminance")}
"""The same for a reading, by its unit."""
_LEFT_OUT = {AutopilotText.name, "home", "airframe"}
_PLACE = {"latitude_deg", "longitude_deg"}


class Entities:
    """The drones and sensors of some fogs as Home Assistant's entities: retained messages, by topic.

    `discovery` is the topic prefix to which Home Assistant subscribes. Drones are unique in a fleet, and so are their
    devices; with several fleets the devices' names begin with the fleet's.
    """

    def __init__(self, fogs: Sequence[Fog], discovery: str = "homeassistant") -> None:
        self._fogs = fogs
        self._discovery = discovery
        self._readings = FirstReadings()
        self.status = f"mqttxt/fogs-{'-'.join(f'{_root_of(fog.fleet)}{fog.number}' for fog in fogs)}/status"
        """The topic that shows whether this program runs."""

    def messages(self) -> Iterator[tuple[str, str]]:
        """The messages for everything known now, topics and payloads, of a drone by the fog that reaches it."""
        found: dict[tuple[str, int], tuple[Fog, Drone]] = {}
        for fog in self._fogs:
            for drone in fog.drones:
                key = (fog.fleet, drone.number)
                if key not in found or (drone.is_reachable and fog.is_live):
                    found[key] = fog, drone
        for fog, drone in found.values():
            yield from self._of_drone(fog, drone)

    def _of_drone(self, fog: Fog, drone: Drone) -> Iterator[tuple[str, str]]:
        node = f"{_root_of(fog.fleet)}drone{drone.number}"
        values: dict[str, Any] = {"reachable": drone.is_reachable, "controlled_by": drone.holder or NOBODY}
        yield self._config(node, "binary_sensor", "reachable", {"device_class": "connectivity"}, is_always=True)
        yield self._config(node, "sensor", "controlled_by", {})
        for name, known in drone.states.items():
            if name in STATES and name not in _LEFT_OUT:
                is_stale = known.age_ms is not None and known.age_ms > STALE_MS
                for component, key, config, newest in _of_state(name, known.state):
                    values[key] = value = None if is_stale else newest
                    if value is not None:
                        yield self._config(node, component, key, config)
        if {"latitude", "longitude"} <= values.keys():
            attributes = f"{self._root(node)}/state"
            place = {"json_attributes_topic": attributes, "source_type": "gps"}
            yield self._config(node, "device_tracker", "location", place, has_value=False)
        for reading in drone.readings:
            key = f"sensor{reading.sensor}_{reading.kind}"
            if self._readings.takes(node, key):
                values[key] = reading.value
                yield self._config(node, "sensor", key, _of_reading(reading))
        yield f"{self._root(node)}/state", json.dumps(values)
        yield f"{self._root(node)}/available", ONLINE if drone.is_reachable and fog.is_live else OFFLINE

    def _root(self, node: str) -> str:
        return f"mqttxt/{node}"

    def _config(
        self,
        node: str,
        component: str,
        key: str,
        config: dict[str, Any],
        *,
        is_always: bool = False,
        has_value: bool = True,
    ) -> tuple[str, str]:
        """An entity's discovery message: topic and payload. `is_always`: available even if the drone is unreachable."""
        name = f"mqttxt_{node}_{_coded(key, '_')}"
        available = [self.status] if is_always else [self.status, f"{self._root(node)}/available"]
        common: dict[str, Any] = {
            "name": _name(key),
            "unique_id": name,
            "availability": [{"topic": topic} for topic in available],
            "availability_mode": "all",
            "device": {"identifiers": [f"mqttxt_{node}"], "name": node, "manufacturer": "MQTT-XT"},
        }
        if has_value:
            common |= {"state_topic": f"{self._root(node)}/state", "value_template": f"{{{{ value_json['{key}'] }}}}"}
        if component == "binary_sensor":
            common |= {"payload_on": "True", "payload_off": "False"}
        return f"{self._discovery}/{component}/{name}/config", json.dumps({**common, **config})


def _name(key: str) -> str:
    """An entity's name, without the unit, which Home Assistant shows next to the value."""
    unit = next((end for end in _UNITS if key.endswith(end)), "")
    return key.removesuffix(unit).replace("_", " ").capitalize()


def _root_of(fleet: str) -> str:
    """The prefix of a fleet's devices, unique to it: ASCII letters, digits, `-`, a final `_`; empty without a fleet."""
    return f"{_coded(fleet)}_" if fleet else ""


def _coded(text: str, kept: str = "") -> str:
    """A text as a part of an entity's id, unique to it: all but ASCII letters, digits and `kept` as codes."""
    return "".join(c if (c.isascii() and c.isalnum()) or c in kept else f"-{ord(c):x}-" for c in text)


def _of_state(name: str, state: object) -> Iterator[tuple[str, str, dict[str, Any], Any]]:
    """The entities of a state: component, key, configuration and value; a location's are its tracker's attributes too.

    An unknown figure has the value None: without a value Home Assistant would keep the last one.
    """
    for field, alone in fields_of(name).items():
        value = getattr(state, field)
        if name == "location" and field in _PLACE:
            yield "sensor", field.removesuffix("_deg"), {"unit_of_measurement": "°"}, value
        elif isinstance(value, bool):
            yield "binary_sensor", alone, {}, value
        elif isinstance(value, Named):
            labels = [each.label for each in type(value)]
            yield "sensor", alone, {"device_class": "enum", "options": labels}, value.label
        elif isinstance(value, int | float) or value is None:
            yield "sensor", alone, _measured(alone), value


def _measured(key: str) -> dict[str, Any]:
    found = next((_UNITS[end] for end in _UNITS if key.endswith(end)), None)
    unit, device_class = found if found is not None else (None, None)
    device_class = "battery" if key == "battery_remaining_pct" else device_class
    given = {"unit_of_measurement": unit, "device_class": device_class, "state_class": "measurement"}
    return {option: value for option, value in given.items() if value is not None}


def _of_reading(reading: SensorReading) -> dict[str, Any]:
    unit, device_class = _KINDS.get(reading.unit, (reading.unit or None, None))
    device_class = "humidity" if reading.kind == "humidity" and unit == "%" else device_class
    given = {"unit_of_measurement": unit, "device_class": device_class, "state_class": "measurement"}
    return {option: value for option, value in given.items() if value is not None}


class HomeAssistant:
    """Publishes `entities` at Home Assistant's broker, and `offline` when it ends, in whatever way."""

    def __init__(self, address: BrokerAddress, entities: Entities) -> None:
        self._entities = entities
        self._said: dict[str, str] = {}
        self._is_up = False
        self._link = MqttLink(LINK, address, f"mqttxt-homeassistant-{secrets.token_hex(4)}", self._will, self)

    async def run(self) -> None:
        """Publish until cancelled; raises BrokerRefused."""
        link = asyncio.create_task(self._link.run())
        try:
            while not link.done():
                self._publish()
                await asyncio.wait({link}, timeout=INTERVAL_S)
            link.result()
        finally:
            self._say(self._entities.status, OFFLINE)
            await self._link.close()
            link.cancel()

    def _will(self) -> Will:
        return Will(self._entities.status, OFFLINE.encode())

    def _publish(self) -> None:
        if not self._is_up:
            return
        for topic, payload in self._entities.messages():
            if self._said.get(topic) != payload:
                self._say(topic, payload)

    def _say(self, topic: str, payload: str) -> None:
        self._said[topic] = payload
        self._link.publish(Publish(LINK, topic, payload.encode(), qos=1, retain=True))

    def connected(self, link: str) -> None:
        self._is_up = True
        self._said.clear()
        self._say(self._entities.status, ONLINE)
        self._publish()

    def disconnected(self, link: str) -> None:
        self._is_up = False

    def received(self, link: str, message: Inbound) -> None:
        """Nothing is subscribed to."""

    def subscribed(self, subscribe: Subscribe) -> None:
        """Nothing is subscribed to."""

    def published(self, link: str, ref: Hashable, code: int) -> None:
        """No PUBACK is awaited."""

    def count(self, kind: str, detail: str) -> None:
        logger.warning("%s: %s", kind, detail)
