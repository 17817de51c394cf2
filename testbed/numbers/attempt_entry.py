"""An attempt's entry in `metrics.json`: the names and types that its schema has (docs/results-folder.md)."""

from typing import Any, NotRequired, TypedDict

Load = dict[str, dict[str, list[int]] | list[int]]
"""Bytes in each second: through each fog by drone, and `total`."""


class Summary(TypedDict):
    """A summary of many values, in their unit; without values all but `n` is None."""

    n: int
    mean: float | None
    p50: float | None
    p90: float | None
    p99: float | None
    max: float | None


class Receipts(TypedDict):
    calls: int
    doubled: int
    late: int


class DelaysEntry(TypedDict):
    """Delays by the captures, and by the programs' own clocks."""

    captures: Summary
    app: Summary | None


class AmountEntry(TypedDict):
    """Frames and their bytes."""

    packets: int
    bytes: int


class SizeEntry(TypedDict):
    """Frames that carry one message between two nodes, in bytes."""

    n: int
    mean: float
    min: int
    max: int
    share: float
    ack_bytes: float | None


class LossEntry(TypedDict):
    """`lost` of `sent`; `below` is the 95 % upper bound of the share where nothing was lost."""

    sent: int
    lost: int
    share: float | None
    below: float | None


class DroneMessages(TypedDict):
    """Messages of a kind to or from one drone."""

    sent: int
    lost: int
    open: int


class KindOfMessages(LossEntry):
    """Messages of one kind in a mission."""

    open: int
    drones: dict[str, DroneMessages]


class MessagesEntry(TypedDict):
    """The messages of a mission, by command and by state."""

    commands: dict[str, KindOfMessages]
    states: dict[str, KindOfMessages]


class MessageLoss(TypedDict):
    """The shares of all commands and of all states that were lost."""

    commands: float | None
    states: float | None


class LinkLosses(TypedDict):
    """Frames lost by cause."""

    random: int
    queue: int
    closed: int
    overload: int
    corrupted: int
    unknown: int
    captured: int
    open: NotRequired[int]


class Losses(LinkLosses):
    """Frames lost on all links together, and on each that lost any."""

    links: dict[str, LinkLosses]


class LinkEntry(TypedDict):
    """The traffic of a directed link."""

    packets: int
    bytes: int
    lost: int
    layers: NotRequired[dict[str, int]]


class LinkEvent(TypedDict):
    """A change of links, in seconds from the window's start."""

    t_s: float
    link: str
    change: dict[str, Any] | None
    cause: str | None


class Retransmissions(TypedDict):
    """Frames that TCP sent again."""

    packets: int
    bytes: int
    needless: int
    links: dict[str, int]


class WindowEntry(TypedDict):
    """The mission's time."""

    start_ns: int
    seconds: float


class OutcomeEntry(TypedDict):
    """The last word about a command to a drone."""

    command: str
    word: str
    reason: str | None
    after_ms: float


class MavlinkStream(TypedDict):
    """A message that an autopilot sends by itself."""

    name: str
    count: int
    rate_hz: float
    bytes: int
    mean_size: float


class MavlinkMessage(TypedDict):
    """A message that the ground station sends."""

    name: str
    count: int
    bytes: int


Router = TypedDict("Router", {"node": str, "way": str, "in": int, "out": int, "dropped": int})
"""Frames that a node's router received, forwarded and dropped."""


class Mavlink(TypedDict):
    """The messages that the MAVLink side sends."""

    streams: list[MavlinkStream]
    commands: list[MavlinkMessage]
    routers: list[Router]
    own_heartbeats: int
    unsent: NotRequired[dict[str, int]]


class KindMessages(LossEntry):
    """Messages of a kind of the message set, and the delay of each in order; None: lost."""

    open: int
    delay_ms: list[float | None]


class KindEntry(KindMessages):
    """A kind of the message set."""

    form: str
    asked: int
    received: int
    reasons: dict[str, int]
    seconds: float
    with_states: AmountEntry
    alone: AmountEntry
    setpoints: AmountEntry | None
    message_bytes: dict[str, SizeEntry]
    frames_per_call: float | None
    delay_app_ms: list[float | None]
    size_histogram: dict[str, int]


class ReadingsEntry(TypedDict):
    """A series of samples of one sensor."""

    drone: int
    sensor: int
    kind: str
    unit: str
    samples: int
    measured: int
    delivered: int
    wrong: int
    whole: bool
    delay_ms: Summary
    delay_app_ms: Summary


class ReadingDelays(TypedDict):
    """The delays of all readings."""

    captures: Summary
    app: Summary


class FlightChange(TypedDict):
    """The time of an event in a flight log, and how much later the captures show it."""

    event: str
    at_s: float
    late_ms: float


class FlightLogEntry(TypedDict):
    """A drone's flight by its autopilot's own log."""

    version: str
    changes: list[FlightChange]
    clock_ms: float
    speed: float
    height_m: float | None
    off: str | None


class MissionNumbers(TypedDict):
    """The numbers from the packets in a mission's window."""

    window: WindowEntry | None
    size_bytes: int
    packets: int
    message_loss: MessageLoss
    commands_sent: int
    states_sent: int
    messages: MessagesEntry
    losses: Losses | None
    delay_ms: dict[str, list[float]]
    delay_app_ms: dict[str, list[float]]
    delay_received_ms: dict[str, list[float]]
    receipts: NotRequired[Receipts | None]
    state_delay_ms: dict[str, DelaysEntry]
    frames_per_call: dict[str, float]
    message_sizes: dict[str, SizeEntry]
    size_histogram: dict[str, int]
    layers: dict[str, int]
    purposes: dict[str, AmountEntry]
    retransmissions: Retransmissions
    load: Load
    traffic: dict[str, list[int]]
    mqtt: dict[str, int]
    mavlink: Mavlink | None
    links: dict[str, LinkEntry]
    links_events: list[LinkEvent]
    before_mission: dict[str, int]
    foreign: dict[str, int]
    truncated: list[str]
    message_set: dict[str, KindEntry] | None
    notes: list[str]


class ReadingsNumbers(TypedDict):
    """The numbers of the sensors' readings."""

    series: list[ReadingsEntry]
    reading_delay_ms: ReadingDelays | None
    reading_traffic: dict[str, dict[str, AmountEntry]]
    out_of_range: int


class AttemptNumbers(MissionNumbers, ReadingsNumbers):
    """All numbers of a mission; they are empty where none began."""

    wire_loss: float | None
    flight_logs: dict[str, FlightLogEntry]


class AttemptEntry(AttemptNumbers):
    """An attempt that counts."""

    attempt: int
    repeat: int
    status: str
    reason: str | None
    mission_s: float | None
    outcomes: dict[str, list[OutcomeEntry]]
    links_measured: dict[str, dict[str, Any]]
    cpu_s: dict[str, float]
    memory_bytes: dict[str, int]
