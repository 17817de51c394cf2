"""Relays signed births unchanged: stations learn the drones' certificates, drones those of their stations."""

from __future__ import annotations

from ..core.effects import Effect, Publish
from ..security.certificate import Certificate
from .drones import CLOUD, FOG, Drones
from .part import Part, Site


class Births(Part):
    """The newest birth of each station and drone that signs (R12.6)."""

    def __init__(self, site: Site, drones: Drones) -> None:
        super().__init__(site)
        self._drones = drones
        self._stations: dict[str, tuple[Certificate, int, bytes]] = {}
        self._of_drones: dict[int, bytes] = {}

    def on_drone(self, drone: int, payload: bytes) -> list[Effect]:
        """A drone's birth: relay it to the stations, and the registered stations' births to the drone."""
        self._of_drones[drone] = payload
        told = [self._publish(station, drone) for station in self._stations if self._is_told(station)]
        return [self._of_drone(drone), *told]

    def on_station(self, station: str, certificate: Certificate, session: int, payload: bytes) -> list[Effect]:
        """A station's birth with a session of its own: relay it to the drones if that is registered."""
        self._stations[station] = certificate, session, payload
        return self.on_registered(station)

    def on_registered(self, station: str) -> list[Effect]:
        """A station has registered: relay its birth to the drones."""
        if station not in self._stations:
            return []
        numbers = [link.number for link in self._drones.links.values() if link.up]
        return [self._publish(station, number) for number in numbers if self._is_told(station)]

    def of_drones(self) -> list[Effect]:
        """Publish the drones' births, for the cloud broker to retain, after the activator's own birth."""
        return [self._of_drone(drone) for drone in self._of_drones]

    def _is_told(self, station: str) -> bool:
        certificate, session, _ = self._stations[station]
        return (station, session) in self._leases and certificate.rights.may_hear

    def _of_drone(self, drone: int) -> Publish:
        return Publish(CLOUD, self._cloud.drone_birth(drone), self._of_drones[drone], qos=1, retain=True)

    def _publish(self, station: str, drone: int) -> Publish:
        return Publish(FOG, self._fog.stations(drone), self._stations[station][2], qos=1)
