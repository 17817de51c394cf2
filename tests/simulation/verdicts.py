"""Judges a simulated history by true time: commands executed late or twice, unanswered, or refused though in time."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from random import Random
from typing import Any

from mqttxt.core.clock import RemoteClock
from mqttxt.core.effects import Inbound, Publish
from mqttxt.drone.command_writer import SENDS
from mqttxt.drone.mavlink.sources import HALTING
from mqttxt.drone.resting_numbers import AckKey
from mqttxt.protocol.codec import decode
from mqttxt.protocol.messages import BeaconMessage, CommandId, CommandMessage, ResultMessage, Word
from mqttxt.station.outcomes import Outcome
from tests.simulation.true_time import Events

RHO = 1e-3
WHOLE_MS = 5.0
"""The most that one hop loses because clocks are read in whole milliseconds (docs/deadlines.md, theorem 3)."""
LONGEST_SHARED_US = 12_000_000
"""How long a hold may still await its acknowledgement: 4 s by R5.6, and the longest stalls."""


@dataclass
class Sent:
    """A command by true time; `early_ms` and `early_drone_ms` bound, by hop, how early it may be refused.

    `unidentified`: drones on which it shares its name with another hold, so that no acknowledgement is surely its own.
    """

    drones: tuple[int, ...]
    called_us: int
    end_us: int
    station: int
    early_ms: float
    selected: bool
    taken_on: set[int] = field(default_factory=set)
    early_drone_ms: dict[int, float] = field(default_factory=dict)
    questioned: bool = False
    writes: dict[int, list[tuple[int, int]]] = field(default_factory=dict)
    acknowledged: set[int] = field(default_factory=set)
    unidentified: set[int] = field(default_factory=set)
    last: Counter[int | None] = field(default_factory=Counter)
    settled: Counter[int | None] = field(default_factory=Counter)
    words: dict[int | None, Word] = field(default_factory=dict)


class Judge:
    """Sees everything and decides; `violations` has a sentence for each, by kind, and is empty when all is well.

    The kinds: `late`, `again`, `elsewhere` (executed by a drone that was not meant), `early` (refused earlier than
    the bound allows), `words` (not exactly one last word).
    """

    def __init__(self, events: Events) -> None:
        self._events = events
        self.sent: dict[CommandId, Sent] = {}
        self.unsent = 0
        self.violations: dict[str, list[str]] = {}
        self.timely_refused = 0
        self.worst_late_ms = 0.0
        self.worst_early_ms = 0.0
        self.last_late_call_us = 0
        self._best_beacon: dict[RemoteClock, float] = {}
        self._station = 0
        self._refused: set[tuple[CommandId, int | None]] = set()
        self._newest_of_last_name: dict[tuple[int, AckKey], tuple[CommandId, int]] = {}

    def station_starts(self) -> None:
        self._station += 1

    def hears_beacon(self, clock: RemoteClock | None, message: Inbound, sent_us: int, now_ms: int) -> None:
        """A role has taken in a beacon: (1 + rho) d - 4 rho t_r orders beacons by the bound that they give."""
        if clock is not None and decode(BeaconMessage, message.payload).session == clock.session:
            read_us = self._events.now_us
            value = ((1 + RHO) * (read_us - sent_us) - 4 * RHO * (1 + 2 * RHO) * read_us) / 1000
            self._best_beacon[clock] = min(value, self._best_beacon.get(clock, float("inf")))

    def _hop_ms(self, clock: RemoteClock, end_us: int) -> float:
        return (self._best_beacon[clock] + 4 * RHO * (1 + 2 * RHO) * end_us / 1000 + WHOLE_MS) / (1 - RHO)

    def calls(self, station: Any, command_id: CommandId, drones: tuple[int, ...], ttl_ms: int, selected: bool) -> None:
        now_us = self._events.now_us
        end_us = now_us + ttl_ms * 1000
        early_ms = self._hop_ms(station.role.fogs[1].clock, end_us)
        self.sent[command_id] = Sent(drones, now_us, end_us, self._station, early_ms, selected)

    def publishes(self, node: Any, publish: Publish, read_us: int) -> None:
        """Look at what a process publishes: commands passed on, and words `expired`."""
        if publish.topic in ("drone1/commands", "drone2/commands"):
            self._hands_on(node, publish)
        elif "/commands_result/" in publish.topic:
            if node.name == "activator" and publish.link == "cloud" and publish.topic.startswith("fog1/commands_"):
                return
            result = decode(ResultMessage, publish.payload)
            if result.word is Word.EXPIRED and result.session == node.clock.session:
                self._refuses(node, result.id, read_us)

    def _hands_on(self, node: Any, publish: Publish) -> None:
        command = decode(CommandMessage, publish.payload)
        sent = self.sent[command.id]
        drone = int(publish.topic[5])
        if command.deadline_ms == 0:
            sent.questioned = True
        elif drone not in sent.early_drone_ms:
            sent.early_drone_ms[drone] = self._hop_ms(node.role.drones.links.get(drone).clock, sent.end_us)

    def _refuses(self, node: Any, command_id: CommandId, read_us: int) -> None:
        sent = self.sent[command_id]
        drone = getattr(node, "number", None)
        if sent.questioned or read_us >= sent.end_us or (command_id, drone) in self._refused:
            return
        self._refused.add((command_id, drone))
        self.timely_refused += 1
        early_ms = (sent.end_us - read_us) / 1000
        bound_ms = sent.early_ms + (sent.early_drone_ms[drone] if drone is not None else 0.0)
        self.worst_early_ms = max(self.worst_early_ms, early_ms)
        if early_ms > bound_ms:
            self._blame("early", f"{command_id} refused {early_ms:.1f} ms early by {node.name}, bound {bound_ms:.1f}")

    def writes(self, node: Any, command_id: CommandId, key: AckKey) -> None:
        """Check a write to an autopilot: in time, not after its acknowledgement, and not by another session."""
        sent = self.sent.get(command_id)
        now_us = self._events.now_us
        if sent is None or node.number not in sent.drones:
            self._blame("elsewhere", f"{command_id} executed by {node.name}, to which it was not sent")
            return
        before = sent.writes.setdefault(node.number, [])
        if now_us > sent.end_us:
            late_ms = (now_us - sent.end_us) / 1000
            self.worst_late_ms = max(self.worst_late_ms, late_ms)
            self.last_late_call_us = max(self.last_late_call_us, sent.called_us)
            self._blame("late", f"{command_id} executed {late_ms:.3f} ms late by {node.name}")
        if key[1] is HALTING[-1]:
            self._shares_the_last_name(node.number, command_id, key)
        elsewhere = any(session != node.clock.session for session, _ in before)
        acknowledged = node.number in sent.acknowledged - sent.unidentified
        if elsewhere or acknowledged or len(before) >= SENDS:
            self._blame("again", f"{command_id} executed again by {node.name}")
        before.append((node.clock.session, now_us))

    def _shares_the_last_name(self, drone: int, command_id: CommandId, key: AckKey) -> None:
        """Note commands that stop, in excess of names: the first acknowledgements are the older ones' (R5.6)."""
        now_us = self._events.now_us
        older, written_us = self._newest_of_last_name.get((drone, key), (command_id, now_us))
        if older != command_id and now_us - written_us < LONGEST_SHARED_US:
            self.sent[command_id].unidentified.add(drone)
        self._newest_of_last_name[drone, key] = command_id, now_us

    def takes_on(self, node: Any, command_id: CommandId) -> None:
        """An autopilot begins to execute a command; one for the best drone may be begun by one drone only."""
        sent = self.sent[command_id]
        sent.taken_on.add(node.number)
        if sent.selected and len(sent.taken_on) > 1:
            self._blame("again", f"{command_id} executed by two drones")

    def acknowledges(self, node: Any, command_id: CommandId) -> None:
        self.sent[command_id].acknowledged.add(node.number)

    def says(self, outcome: Outcome) -> None:
        """Take an outcome that a station reports to its caller."""
        sent = self.sent[outcome.id]
        if outcome.is_last:
            sent.last[outcome.drone] += 1
            sent.words[outcome.drone] = outcome.word
        elif outcome.settled:
            sent.settled[outcome.drone] += 1

    def aim(self, publish: Publish, rng: Random, chance: float) -> int | None:
        """When a command is to arrive: around its true deadline, where it does the most harm. None: by chance."""
        is_last_hop = publish.topic.startswith("drone")
        if not publish.topic.endswith("commands") or rng.random() >= (chance if is_last_hop else chance / 8):
            return None
        sent = self.sent.get(decode(CommandMessage, publish.payload).id)
        if sent is None:
            return None
        around_ms = rng.choice((3, 30, 150, 600))
        return sent.end_us + rng.randint(-around_ms * 1000, around_ms * 1000)

    def close(self) -> None:
        """Check that each drone of each command has exactly one last word, unless its station was killed."""
        for command_id, sent in self.sent.items():
            counted = {drone: count for drone, count in sent.last.items() if count}
            answered = counted.get(None, 0) == 1 if len(sent.drones) > 1 else False
            answered = answered or set(counted) == set(sent.drones) or (sent.selected and bool(counted))
            twice = any(count > 1 for count in (*counted.values(), *sent.settled.values()))
            if twice or (sent.station == self._station and not answered):
                self._blame("words", f"{command_id} has last words {counted}, settled {dict(sent.settled)}")

    def _blame(self, kind: str, sentence: str) -> None:
        self.violations.setdefault(kind, []).append(sentence)

    def counts(self) -> Counter[str]:
        """Counts of commands, executions by a drone, refusals although in time, last words and violations."""
        counted = Counter(word.label for sent in self.sent.values() for word in sent.words.values())
        counted["commands"] = len(self.sent)
        counted["executed"] = sum(len(sent.writes) for sent in self.sent.values())
        counted["refused although in time"] = self.timely_refused
        counted.update({f"VIOLATED: {kind}": len(found) for kind, found in self.violations.items()})
        return counted
