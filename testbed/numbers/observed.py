"""The observations of a series, typed: the only reader of the attempts in `metrics.json`.

`quantities` and `kinds` make every figure from them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ..plan.wording import PROTOCOL_NAMES
from .attempt_entry import AttemptEntry, KindEntry, KindOfMessages, SizeEntry
from .written import SideEntry


@dataclass(frozen=True)
class Loss:
    """`lost` of `known` messages or frames: all that were sent, less those still `open` where the captures end."""

    lost: int
    known: int
    open: int = 0

    def __add__(self, other: Loss) -> Loss:
        return Loss(self.lost + other.lost, self.known + other.known, self.open + other.open)

    @property
    def share(self) -> float | None:
        return self.lost / self.known if self.known else None

    @property
    def below(self) -> float | None:
        """The 95 % upper bound of the share where nothing was lost, by the rule of three; None elsewhere."""
        return min(1.0, 3 / self.known) if self.known and not self.lost else None


NOTHING_SENT = Loss(0, 0)


@dataclass(frozen=True)
class Amount:
    """Frames and their bytes."""

    packets: float
    bytes: float


@dataclass(frozen=True)
class FrameSizes:
    """Frames that carry one message between two nodes, in bytes; `ack` is the mean cost of an acknowledgement on a
    link, None without one."""

    count: int
    mean: float
    least: int
    most: int
    ack: float | None

    @property
    def span(self) -> str:
        """'86 to 91', empty where all are the same."""
        return f"{self.least} to {self.most}" if self.least != self.most else ""


@dataclass(frozen=True)
class ObservedKind:
    """A kind of the message set in one attempt; the delay of a lost message is None."""

    name: str
    form: str
    asked: int
    received: int
    reasons: Mapping[str, int]
    seconds: float
    with_states: Amount
    alone: Amount
    setpoints: Amount | None
    frames: Mapping[str, FrameSizes]
    loss: Loss
    delays_ms: tuple[float | None, ...]
    app_ms: tuple[float | None, ...]
    frames_per_call: float | None


@dataclass(frozen=True)
class ObservedAttempt:
    """A completed or failed attempt, in the window of its mission; `mission_s` is None if it failed.

    `window_s` is how long frames were counted, None if the mission never began. `frames` leaves out the frames sent
    into a sensor's closed link while its drone was out of range: they show when a drone came near, not how links lose.
    """

    number: int
    status: str
    mission_s: float | None
    window_s: float | None
    packets: int
    size_bytes: int
    commands: Loss
    states: Loss
    frames: Loss
    delays_ms: tuple[float, ...]
    longest_state_ms: float | None
    doubled: int | None
    late: int | None
    frames_per_call: Mapping[str, float]
    retransmitted: int
    cpu_s: Mapping[str, float]
    memory_bytes: Mapping[str, int]
    purposes: Mapping[str, int]
    layers: Mapping[str, int]
    kinds: Mapping[str, ObservedKind]

    @property
    def completed(self) -> bool:
        return self.status == "completed"


@dataclass(frozen=True)
class Side:
    """One protocol's attempts that count, in order, and the number of void ones."""

    attempts: tuple[ObservedAttempt, ...]
    void: int

    @property
    def completed(self) -> tuple[ObservedAttempt, ...]:
        return tuple(attempt for attempt in self.attempts if attempt.completed)


Sides = dict[str, Side]
"""By protocol, MQTT-XT first."""
NO_SIDE = Side((), 0)


def in_order(protocols: Mapping[str, object]) -> list[str]:
    """The protocols of a series; MQTT-XT first, then MAVLink."""
    known = list(PROTOCOL_NAMES)
    return sorted(protocols, key=lambda name: (known.index(name) if name in known else len(known), name))


def observe(protocols: Mapping[str, SideEntry]) -> Sides:
    """Read `protocols` of a series' metrics."""
    return {name: _side(protocols[name]) for name in in_order(protocols)}


def _side(side: SideEntry) -> Side:
    return Side(tuple(observe_attempt(one) for one in side["attempts"]), len(side["void"]))


def observe_attempt(entry: AttemptEntry) -> ObservedAttempt:
    """Read one attempt's entry in `metrics.json`."""
    window = entry["window"]
    lost = sum(link["lost"] for link in entry["links"].values())
    unreached = entry["out_of_range"]
    got = entry.get("receipts")
    return ObservedAttempt(
        number=entry["attempt"],
        status=entry["status"],
        mission_s=entry["mission_s"],
        window_s=window["seconds"] if window is not None else None,
        packets=entry["packets"],
        size_bytes=entry["size_bytes"],
        commands=_messages(entry["messages"]["commands"]),
        states=_messages(entry["messages"]["states"]),
        frames=Loss(lost - unreached, entry["packets"] - unreached),
        delays_ms=tuple(ms for of_command in entry["delay_ms"].values() for ms in of_command),
        longest_state_ms=max(
            (ms for one in entry["state_delay_ms"].values() if (ms := one["captures"]["max"]) is not None), default=None
        ),
        doubled=got["doubled"] if got is not None else None,
        late=got["late"] if got is not None else None,
        frames_per_call=entry["frames_per_call"],
        retransmitted=entry["retransmissions"]["packets"],
        cpu_s=entry["cpu_s"],
        memory_bytes=entry["memory_bytes"],
        purposes={name: counted["bytes"] for name, counted in entry["purposes"].items()},
        layers=entry["layers"],
        kinds={name: _kind(name, kind) for name, kind in (entry["message_set"] or {}).items()},
    )


def _messages(kinds: Mapping[str, KindOfMessages]) -> Loss:
    return sum((_loss(kind) for kind in kinds.values()), NOTHING_SENT)


def _loss(counted: KindOfMessages | KindEntry) -> Loss:
    return Loss(counted["lost"], counted["sent"] - counted["open"], counted["open"])


def _kind(name: str, kind: KindEntry) -> ObservedKind:
    return ObservedKind(
        name=name,
        form=kind["form"],
        asked=kind["asked"],
        received=kind["received"],
        reasons=kind["reasons"],
        seconds=kind["seconds"],
        with_states=Amount(**kind["with_states"]),
        alone=Amount(**kind["alone"]),
        setpoints=Amount(**kind["setpoints"]) if kind["setpoints"] is not None else None,
        frames={message: _sizes(size) for message, size in kind["message_bytes"].items()},
        loss=_loss(kind),
        delays_ms=tuple(kind["delay_ms"]),
        app_ms=tuple(kind["delay_app_ms"]),
        frames_per_call=kind["frames_per_call"],
    )


def _sizes(size: SizeEntry) -> FrameSizes:
    return FrameSizes(size["n"], size["mean"], size["min"], size["max"], size["ack_bytes"])
