"""Relays signed births unchanged: stations learn the drones' certificates, drones those of their stations."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from ..core.effects import Effect, Publish
from ..core.session_owners import MOST_OF_ONE
from ..security.certificate import Certificate
from .drones import CLOUD, FOG, Drones
from .leases import Key
from .part import Part, Site

AGAIN = MOST_OF_ONE // 2
"""After so many births of other sessions of its station a birth is told again, before a drone forgets the session."""


@dataclass
class _Birth:
    """The newest birth of a station's session; `told`: its number among those of its station that drones were told."""

    certificate: Certificate
    payload: bytes
    told: int | None = None


class Births(Part):
    """The newest birth of each session of a station, and of each drone, that signs (R12.6).

    Programs of one station show their births on one topic, in turn and without end (R9.1): drones are told what is new.
    """

    def __init__(self, site: Site, drones: Drones) -> None:
        super().__init__(site)
        self._drones = drones
        self._stations: dict[Key, _Birth] = {}
        self._of_drones: dict[int, bytes] = {}
        self._told: Counter[str] = Counter()

    def on_drone(self, drone: int, payload: bytes) -> list[Effect]:
        """A drone's birth: relay it to the stations, and the registered stations' births to the drone."""
        self._of_drones[drone] = payload
        told = list[Effect]()
        for key, birth in self._stations.items():
            if self._may_tell(key, birth):
                told.append(self._publish(birth, drone))
            else:
                birth.told = None  # the drone may have started anew, and not have it
        return [self._of_drone(drone), *told]

    def on_station(self, station: str, certificate: Certificate, session: int, payload: bytes) -> list[Effect]:
        """A station's birth with a session of its own: relay it to the drones if that is registered."""
        key = station, session
        known = self._stations.pop(key, None)
        told = known.told if known is not None and known.payload == payload else None
        self._stations[key] = _Birth(certificate, payload, told)
        own = [each for each in self._stations if each[0] == station]
        for forgotten in own[:-MOST_OF_ONE]:
            if forgotten not in self._leases:
                del self._stations[forgotten]
        return self.on_registered(key, anyway=False)

    def on_registered(self, key: Key, anyway: bool) -> list[Effect]:
        """A station has registered: relay its birth to the drones, unless they have it and it is not told `anyway`."""
        birth, told = self._stations.get(key), self._told[key[0]]
        if birth is None or not self._may_tell(key, birth):
            return []
        if birth.told is not None and told < birth.told + AGAIN and not anyway:
            return []
        birth.told = self._told[key[0]] = told + 1
        return [self._publish(birth, link.number) for link in self._drones.links.values() if link.up]

    def of_drones(self) -> list[Effect]:
        """Publish the drones' births, for the cloud broker to retain, after the activator's own birth."""
        return [self._of_drone(drone) for drone in self._of_drones]

    def _may_tell(self, key: Key, birth: _Birth) -> bool:
        return key in self._leases and birth.certificate.rights.may_hear

    def _of_drone(self, drone: int) -> Publish:
        return Publish(CLOUD, self._cloud.drone_birth(drone), self._of_drones[drone], qos=1, retain=True)

    def _publish(self, birth: _Birth, drone: int) -> Publish:
        return Publish(FOG, self._fog.stations(drone), birth.payload, qos=1)
