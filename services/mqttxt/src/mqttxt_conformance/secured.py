"""The kit's roles in a fleet that signs: activator and station for a UAV client, activator and drone for a station."""

from __future__ import annotations

from dataclasses import replace

from mqttxt.protocol.codec import encode
from mqttxt.protocol.messages import Presence
from mqttxt.protocol.topics import CloudSide, FogSide
from mqttxt.security.cose import Envelope
from mqttxt.security.seal import Seal

from .registry import Broken
from .sealed import STATION, Folder, Speech, addressed
from .tap import Heard


class SecuredUav:
    """The kit's roles for a UAV client that signs: its fog's activator, and the station whose commands it forwards."""

    def __init__(self, folder: Folder, fog: int, drone: int, topics: FogSide) -> None:
        self.folder = folder
        self.activator = folder.seal(f"fog{fog}")
        self.station = folder.seal(f"gs-{STATION}")
        self.introduced: set[int] = set()
        self.name = f"drone{drone}"
        self._topics = topics
        self._lease = topics.init_connect(drone)
        self._signed_by_station = (topics.commands(drone), topics.control(drone), topics.bulk(drone))
        self.counter = 0
        self._clock = topics.clock(drone), f"fog{fog}/drone{drone}/clock"
        words = f"{topics.root}drone{drone}/commands_result/"
        self._own = topics.reachable(drone), words, topics.bulk_answer(drone)
        self.speech = Speech(self.activator.identity, self._signer, topics.root)

    def _signer(self, topic: str) -> str | tuple[str, str] | None:
        if topic == self._clock[0]:
            return self.name, self._clock[1]
        return self.name if topic.startswith(self._own) else None

    def sealed(self, topic: str, payload: bytes) -> bytes:
        """A payload for a topic, signed by the kit's activator or station."""
        return self.envelope(topic, payload).encode()

    def envelope(self, topic: str, payload: bytes, seal: Seal | None = None) -> Envelope:
        """A payload signed by the topic's sender or with `seal`; a lease carries its signer's certificate (R12.6)."""
        own = self.station if topic in self._signed_by_station else self.activator
        return (seal or own).sign(topic.removeprefix(self._topics.root), payload, with_certificate=topic == self._lease)

    def birth(self, gs_session: int, seal: Seal | None = None) -> bytes:
        """A station's signed birth, as the activator passes it on."""
        seal = seal or self.station
        topic = f"gs/{seal.name.removeprefix('gs-')}/reachable"
        return seal.sign(topic, encode(Presence(session=gs_session, up=True)), with_certificate=True).encode()


class SecuredFog:
    """The kit's roles for a station that signs: a fog's activator, and the drone whose messages it passes on."""

    def __init__(self, folder: Folder, topics: CloudSide, drone: int) -> None:
        self.folder = folder
        self.activator = folder.seal(f"fog{topics.fog}")
        self.outside: list[tuple[int, int]] = []
        """The activator's session and deadline of each command; they are outside the signature."""
        self._station = f"gs-{STATION}"
        self._drone = folder.seal(f"drone{drone}")
        self._number = drone
        self._topics = topics
        self._of_drone = {
            topics.drone_birth(drone): f"drone{drone}/reachable",
            topics.drone_clock(drone): f"fog{topics.fog}/drone{drone}/clock",
        }
        self.speech = Speech(self.activator.identity, self._signer, topics.prefix)

    def _signer(self, topic: str) -> str | None:
        below = topic.removeprefix(self._topics.prefix)
        return self._station if below.startswith("gs/") or topic == self._topics.init_connect else None

    def read(self, heard: Heard) -> Heard:
        """Unwrap a message as `speech` does; also the drone's envelope of a command, grants, and `sensor_ack`."""
        own = f"drone{self._number}/"
        as_said = {
            self._topics.drone_control(self._number): f"{own}control",
            self._topics.drone_sensor_ack(self._number): f"{own}sensor_ack",
        }
        if heard.topic in as_said and heard.payload:
            said = self.speech.checked(as_said[heard.topic], heard.payload, self._station)
            return heard if said is None else replace(heard, payload=said)
        commands = (self._topics.drone_commands(self._number), self._topics.broadcast)
        if heard.topic not in commands or not heard.payload:
            return self.speech.read(heard)
        try:
            session, deadline_ms, envelope = addressed(heard.payload, self._number)
        except Broken as broken:
            self.speech.wrong.append(f"{heard.topic}: {broken}")
            return heard
        self.outside.append((session, deadline_ms))
        payload = self.speech.checked(f"{own}commands", envelope, self._station)
        return heard if payload is None else replace(heard, payload=payload)

    def sealed(self, topic: str, payload: bytes) -> bytes:
        """A payload for a topic, signed by the kit's activator or drone."""
        below = f"{self._topics.root}drone{self._number}/"
        if topic.startswith(f"{below}commands_result/"):
            return self.word(topic, payload, self._drone)
        if topic in self._of_drone:
            with_certificate = topic == self._topics.drone_birth(self._number)
            return self._drone.sign(self._of_drone[topic], payload, with_certificate).encode()
        with_certificate = topic == self._topics.reachable
        return self.activator.sign(topic.removeprefix(self._topics.prefix), payload, with_certificate).encode()

    def word(self, topic: str, payload: bytes, seal: Seal) -> bytes:
        """A word signed with `seal`, with the route that the activator adds."""
        below = topic.removeprefix(self._topics.root)
        return seal.sign(below, payload).routed([None, False]).encode()
