"""Adversaries of a fleet that signs: hostile brokers, and an activator whose key was stolen."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from functools import cached_property
from random import Random
from typing import Any

import cbor2

from mqttxt.activator.drones import FOG
from mqttxt.core.effects import Inbound, Publish
from mqttxt.errors import PayloadError
from mqttxt.protocol.codec import decode, encode
from mqttxt.protocol.commands import Arm
from mqttxt.protocol.control import Control, DroneLease, Registration
from mqttxt.protocol.messages import BeaconMessage, CommandMessage, Presence, ResultMessage, Word
from mqttxt.security.addressed import Addressed
from mqttxt.security.cose import Envelope
from mqttxt.security.rights import Rights
from mqttxt.security.seal import Seal
from mqttxt.station.outcomes import Outcome
from tests.simulation.adversary import Dangers, Simulation
from tests.simulation.nodes import DRONES, MS, ActivatorNode, S
from tests.simulation.signing import seal
from tests.simulation.true_time import Broker, Connection, Events
from tests.simulation.verdicts import Judge

KEPT = 400
HOLDS_BACK = 0.03
"""The probability, per command, that a broker begins to hold back the commands of its topic."""
THIEF = "activator"


def signed_payload(payload: bytes) -> bytes:
    """The signed payload of a message, the first if there are several. Raises PayloadError."""
    try:
        return Envelope.parse(payload).payload
    except PayloadError:
        return next(iter(Addressed.parse(payload).entries.values())).payload


class SignedJudge(Judge):
    """Judges by signed contents. A hostile network may get anything refused early: that is not judged.

    It has another kind of violation, `false`: a command that the station takes for `completed` was not executed.
    """

    def hears_beacon(self, clock: Any, message: Inbound, sent_us: int, now_ms: int) -> None: ...

    def publishes(self, node: Any, publish: Publish, read_us: int) -> None: ...

    def _hop_ms(self, clock: Any, end_us: int) -> float:
        return float("inf")

    def says(self, outcome: Outcome) -> None:
        super().says(outcome)
        if outcome.word is Word.COMPLETED and outcome.drone not in self.sent[outcome.id].writes:
            self._blame("false", f"{outcome.id} completed by drone {outcome.drone}, which has not executed it")

    def aim(self, publish: Publish, rng: Random, chance: float) -> int | None:
        if not publish.topic.endswith("commands") or rng.random() >= chance:
            return None
        try:
            sent = self.sent.get(decode(CommandMessage, signed_payload(publish.payload)).id)
        except (PayloadError, StopIteration):
            return None
        around_ms = rng.choice((3, 30, 150, 600))
        return None if sent is None else sent.end_us + rng.randint(-around_ms * 1000, around_ms * 1000)


class Forger:
    """An adversary's messages: overheard ones, as they are or changed, and made-up ones signed with its own keys."""

    def __init__(self, rng: Random) -> None:
        self.rng = rng
        self.seen: list[Publish] = []
        self.wills: list[Publish] = []
        """Signed wills, which a broker has from CONNECT on and may publish at any time."""
        self.attempts: Counter[tuple[str, str]] = Counter()
        """Attempts by place (a broker's connection or THIEF) and method; an unchanged message is none."""
        self._insider, self._stranger = seal("gs-eve", Rights(observe=True)), seal("gs-g", fleet="other")
        self._neighbour = seal("gs-two", Rights(command=frozenset({2})))
        """May command drone 2, but was never connected: nothing that it signs is in a session of its own."""

    def hear(self, publish: Publish) -> None:
        """Remember a message, sometimes in the place of an older one."""
        if len(self.seen) < KEPT:
            self.seen.append(publish)
        else:
            self.seen[self.rng.randrange(KEPT)] = publish

    def forged(self, passing: Publish) -> Publish | None:
        """A forgery to deliver beside a passing message, or None.

        If a command passes, mostly a forgery of that: nothing newer overtakes it, so only its defect keeps it out.
        """
        link = passing.link
        wills = [will for will in self.wills if will.link == link]
        if wills and self.rng.random() < 0.01:
            self.attempts[link, "will replayed"] += 1
            return self.rng.choice(wills)
        among = [publish for publish in self.seen if publish.link == link]
        if not among:
            return None
        if passing.topic.endswith("/commands") and self.rng.random() < 0.7:
            among = [passing]
            ways = [self._replayed, self._moved, self._rerouted, self._altered, self._altered, self._worded]
        else:
            commands = [publish for publish in among if publish.topic.endswith("/commands")]
            among = commands if commands and self.rng.random() < 0.5 else among
            ways = [self._replayed, self._moved, self._flipped, self._rerouted, self._swapped, self._altered]
            ways += [self._made_up]
        way, chosen = self.rng.choice(ways), self.rng.choice(among)
        publish = way(chosen)
        if publish is None or (publish == chosen and way != self._replayed):
            return None
        self.attempts[link, way.__name__.strip("_")] += 1
        return publish

    def have_will(self, publish: Publish) -> None:
        """Keep the newest will of each topic, and the one before: that of a connection, or a process, that is gone."""
        of_others = [will for will in self.wills if will.topic != publish.topic]
        of_topic = [will for will in self.wills if will.topic == publish.topic and will != publish]
        self.wills = [*of_others, *of_topic[-1:], publish]

    def _replayed(self, publish: Publish) -> Publish:
        return replace(publish, retain=self.rng.random() < 0.3)

    def _moved(self, publish: Publish) -> Publish:
        """The message on another topic: the other drone's, or any."""
        if "drone1" in publish.topic or "drone2" in publish.topic:
            other = publish.topic.replace("drone1", "drone#").replace("drone2", "drone1").replace("drone#", "drone2")
            return replace(publish, topic=other)
        return replace(publish, topic=self.rng.choice(self.seen).topic)

    def _flipped(self, publish: Publish) -> Publish:
        payload = bytearray(publish.payload)
        payload[self.rng.randrange(len(payload))] ^= 1 << self.rng.randrange(8)
        return replace(publish, payload=bytes(payload))

    def _rerouted(self, publish: Publish) -> Publish | None:
        """The message with another deadline, stamp or session outside of the signatures."""
        try:
            envelope = Envelope.parse(publish.payload)
        except PayloadError:
            return self._readdressed(publish)
        if publish.topic.endswith("/commands"):
            return replace(publish, payload=self.later(envelope).encode())
        beside = self.rng.choice([None, 0, 2**53 - 1, self.rng.randrange(2**40), [1, True], [None, False]])
        return replace(publish, payload=envelope.routed(beside).encode())

    def later(self, envelope: Envelope) -> Envelope:
        """A command with another deadline beside the signed payload, mostly a later, plausible one."""
        signed_ms = decode(CommandMessage, envelope.payload).deadline_ms or 0
        plausible = [signed_ms + more_ms for more_ms in (500, 5000, 20_000)]
        return envelope.routed(self.rng.choice([None, 2**53 - 1, *plausible, *plausible]))

    def _readdressed(self, publish: Publish) -> Publish | None:
        try:
            addressed = Addressed.parse(publish.payload)
        except PayloadError:
            return None
        session = self.rng.choice([addressed.executor_session, addressed.executor_session, 0, 7])
        deadline_ms = addressed.deadline_ms + self.rng.choice([-10_000, 500, 20_000, 2**40])
        return replace(
            publish, payload=replace(addressed, executor_session=session, deadline_ms=max(0, deadline_ms)).encode()
        )

    def _swapped(self, publish: Publish) -> Publish | None:
        """A command signed for one drone as if it were for the other."""
        try:
            addressed = Addressed.parse(publish.payload)
        except PayloadError:
            return None
        entries = {3 - drone: envelope for drone, envelope in addressed.entries.items()}
        return replace(publish, payload=replace(addressed, entries=entries).encode())

    def _altered(self, publish: Publish) -> Publish | None:
        """The message with other contents under the old signature, or under that of a station that no node has met."""
        try:
            addressed = Addressed.parse(publish.payload)
        except PayloadError:
            return self._altered_envelope(publish)
        entries = {drone: self._changed(f"drone{drone}/commands", one) for drone, one in addressed.entries.items()}
        return replace(publish, payload=replace(addressed, entries=entries).encode())

    def _altered_envelope(self, publish: Publish) -> Publish | None:
        try:
            envelope = Envelope.parse(publish.payload)
        except PayloadError:
            return None
        topic = publish.topic.removeprefix("fog1/") if "/drone" in publish.topic else publish.topic
        return replace(publish, payload=self._changed(topic, envelope).encode())

    def _changed(self, topic: str, envelope: Envelope) -> Envelope:
        """The envelope with other numbers: the next ids, later deadlines, clocks that are ahead, other words."""
        plain = cbor2.loads(envelope.payload)
        for place in self.rng.sample(range(1, len(plain)), min(2, len(plain) - 1)):
            if type(plain[place]) is int:
                plain[place] += self.rng.choice([1, 1000, 20_000])
        payload = cbor2.dumps(plain, canonical=True)
        if topic.endswith("/commands") and self.rng.random() < 0.7:  # all but the signature may be right
            command = decode(CommandMessage, envelope.payload)
            payload = encode(replace(command, seq=command.seq + self.rng.choice([1, 2]), command=Arm()))
        by = self.rng.choice([None, None, self._neighbour, self._insider, self._stranger])
        if by is None:
            return replace(envelope, payload=payload)
        return by.sign(topic, payload, with_certificate=self.rng.random() < 0.7).routed(envelope.route)

    def _worded(self, publish: Publish) -> Publish | None:
        """A word `completed` about a command, as if a drone had published it."""
        if not publish.topic.endswith("/commands"):
            return None
        drone = self.rng.choice(DRONES)
        command = decode(CommandMessage, signed_payload(publish.payload))
        word = ResultMessage(
            gs_session=command.gs_session,
            seq=command.seq,
            session=command.executor_session or 1,
            stamp=1,
            word=Word.COMPLETED,
        )
        own = f"drone{drone}/commands_result/{command.command.name}"
        topic = own if publish.link == FOG else f"fog1/{own}"
        by = self.rng.choice([None, self._neighbour, self._insider, self._stranger])
        route = None if publish.link == FOG else [1, False]
        payload = encode(word) if by is None else by.sign(own, encode(word), True).routed(route).encode()
        return replace(publish, topic=topic, payload=payload)

    def _made_up(self, publish: Publish) -> Publish:
        """An insider's commands in sessions that it has seen, beacons that are ahead, leases without end."""
        drone = self.rng.choice(DRONES)
        session = self.rng.choice([self._some_session(), self.rng.randrange(1, 2**32)])
        command = CommandMessage(
            gs_session=session,
            seq=self.rng.randrange(200),
            executor_session=self._some_session(),
            deadline_ms=10**6,
            limit_s=3.0,
            command=Arm(),
        )
        lease = DroneLease(
            activator_session=session,
            drone_session=self._some_session(),
            nonce=1,
            bound=self.rng.random() < 0.5,
            epoch=2**32 - 1,
        )
        said: list[tuple[str, object]] = [
            (f"drone{drone}/commands", command),
            (f"drone{drone}/init_connect", lease),
            (f"drone{drone}/clock", BeaconMessage(session=self._some_session(), now_ms=10**9, nonce=1, held_ms=0)),
            (f"drone{drone}/reachable", Presence(session=session, up=self.rng.random() < 0.5)),
            ("gs/eve/reachable", Presence(session=session, up=True)),
            ("fog1/clock", BeaconMessage(session=self._some_session(), now_ms=10**9)),
            (
                "fog1/init_connect",
                Registration(
                    name="eve",
                    session=session,
                    nonce=1,
                    lease_s=3600,
                    control=Control.TAKE,
                    until_ms=10**9,
                    epoch=2**32 - 1,
                    activator_session=self._some_session(),
                    counter=2**32 - 1,
                ),
            ),
            (
                f"drone{drone}/commands_result/arm",
                ResultMessage(gs_session=session, seq=1, session=self._some_session(), stamp=1, word=Word.COMPLETED),
            ),
        ]
        topic, message = self.rng.choice(said)
        if publish.topic.startswith("fog1/") and topic.startswith("drone"):
            topic = f"fog1/{topic}"
        if self.rng.random() < 0.2:
            return replace(publish, topic=topic, payload=encode(message))
        signed = self._insider.sign(topic.removeprefix("fog1/") if "drone" in topic else topic, encode(message), True)
        addressed = Addressed(self._some_session(), 10**9, {drone: signed})
        as_command = topic.startswith("fog1/") and topic.endswith("/commands")
        return replace(publish, topic=topic, payload=addressed.encode() if as_command else signed.encode())

    def _some_session(self) -> int:
        """A number out of a signed message, mostly a session."""
        try:
            plain = cbor2.loads(signed_payload(self.rng.choice(self.seen).payload))
        except (PayloadError, StopIteration, cbor2.CBORError, UnicodeDecodeError):
            return 1
        numbers = [n for n in plain if type(n) is int and 0 < n < 2**32] if isinstance(plain, list) else []
        return self.rng.choice(numbers) if numbers else 1


class HostileBroker(Broker):
    """Delivers messages, and forgeries of them; its reason codes and retained messages mean nothing."""

    def __init__(self, events: Events, forger: Forger, rate: float) -> None:
        super().__init__(events)
        self._forger = forger
        self._rate = rate
        self._held_until_us: dict[str, int] = {}

    def connect(self, connection: Connection) -> None:
        super().connect(connection)
        will = connection.will
        if will is not None:
            self._forger.have_will(Publish(connection.link, will.topic, will.payload, 1, retain=True))

    def route(self, connection: Connection, publish: Publish, read_us: int) -> None:
        rng = self._forger.rng
        self._forger.hear(publish)
        if self._rate and publish.topic.endswith("/commands") and self._holds_back(publish):
            connection.tell(connection.client.published, publish.ref, 0)
            return
        before = self.retained.get(publish.topic)
        super().route(connection, publish, read_us)
        if before is not None and before[0] != publish and rng.random() < 0.05:
            self.retained[publish.topic] = before
            self._forger.attempts[publish.link, "rolled back"] += 1
        if publish.qos > 0 and publish.ref is not None and rng.random() < 0.1:
            connection.tell(connection.client.published, publish.ref, 0x10)
            self._forger.attempts[publish.link, "said 0x10"] += 1
        if rng.random() < self._rate * (3 if publish.topic.endswith("/commands") else 1):
            forged = self._forger.forged(publish)
            if forged is not None:
                self._events.after(rng.choice((0, 50 * MS, 2 * S, 30 * S)), self._deliver, forged)

    def _holds_back(self, publish: Publish) -> bool:
        """Whether to deliver it later, as all commands of its topic for some seconds: nothing newer overtakes them."""
        rng, now_us, until_us = self._forger.rng, self._events.now_us, self._held_until_us.get(publish.topic, 0)
        if now_us >= until_us:
            if rng.random() >= HOLDS_BACK:
                return False
            until_us = self._held_until_us[publish.topic] = now_us + rng.randint(1 * S, 4 * S)
        if publish.link == FOG and rng.random() < 0.5:
            publish = replace(publish, payload=self._forger.later(Envelope.parse(publish.payload)).encode())
        self._events.at(until_us, self._deliver, publish)
        self._forger.attempts[publish.link, "held back"] += 1
        return True

    def _deliver(self, publish: Publish) -> None:
        """Deliver to all subscribers, with its RETAIN flag, and without an answer to its publisher."""
        if self.alive:
            self._spread(publish, self._events.now_us)


class Thief(ActivatorNode):
    """An activator whose key was stolen: the thief publishes what it likes, when it likes, in the activator's name."""

    def _carry_out_one(self, output: Any, read_us: int) -> None:
        sim, rng = self.sim, self.sim.rng
        assert isinstance(sim, HostileSimulation)
        if not isinstance(output, Publish) or rng.random() < 0.5:
            super()._carry_out_one(output, read_us)
            return
        for said in self._instead(sim, output):
            is_other = (said.topic, said.payload) != (output.topic, output.payload)
            sim.forger.attempts[THIEF, "stolen key"] += is_other
            self._soon(rng.choice((0, 0, 200 * MS, 3 * S, 12 * S)), super()._carry_out_one, said, read_us)

    def _instead(self, sim: HostileSimulation, publish: Publish) -> list[Publish]:
        rng = sim.rng
        if publish.link == FOG and publish.topic.endswith("/commands"):
            later = sim.forger.later(Envelope.parse(publish.payload))
            again = replace(publish, payload=later.encode(), ref=None)
            other = "drone2/commands" if publish.topic.startswith("drone1") else "drone1/commands"
            return [again, publish, replace(again, topic=other), again][: rng.randint(0, 4)]
        if publish.link == FOG and publish.topic.endswith("/init_connect"):
            lease = decode(DroneLease, signed_payload(publish.payload))
            newer = {"counter": (lease.counter or 0) + 1, "heard_ms": (lease.heard_ms or 0) + 1}
            wide = replace(lease, deadline_ms=10**9, offboard_until_ms=10**9, epoch=0, **newer)
            return [publish, self._signed(sim, publish, encode(wide))]
        if "/commands_result/" in publish.topic and "drone" in publish.topic:
            result = decode(ResultMessage, signed_payload(publish.payload))
            lie = replace(result, word=rng.choice(list(Word)), reason="stolen")
            return [self._signed(sim, publish, encode(lie)), publish][: rng.randint(0, 2)]
        return [publish]

    def _signed(self, sim: HostileSimulation, publish: Publish, payload: bytes) -> Publish:
        return replace(
            publish, payload=sim.stolen.sign(publish.topic, payload, with_certificate=True).encode(), ref=None
        )


class HostileSimulation(Simulation):
    """A fleet that signs, under brokers that forge at `rate` per message, with an honest activator or a thief."""

    def __init__(self, seed: int, dangers: Dangers, rate: float, thief: bool = False) -> None:
        self._rate = rate
        self._thief = thief
        super().__init__(seed, dangers)

    @cached_property
    def forger(self) -> Forger:
        return Forger(self.rng)

    @cached_property
    def stolen(self) -> Seal:
        return seal("fog1")

    def make_judge(self) -> Judge:
        return SignedJudge(self.events)

    def make_broker(self) -> Broker:
        return HostileBroker(self.events, self.forger, self._rate)

    def make_activator(self) -> ActivatorNode:
        return Thief(self, "activator") if self._thief else super().make_activator()

    def seal(self, name: str) -> Seal | None:
        return seal(name)
