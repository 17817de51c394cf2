"""MAVLink end to end: calls by the commands that they sent, states and routers by a message's own key."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import polars as pl

from ..attempt_entry import Mavlink, MavlinkMessage, MavlinkStream, Router
from ..packets import Packets
from .exchange import SENT, Exchange, calls_in, mean_frames, with_arrivals
from .ways import STATION, Ways
from .window import MAV_CMD_ARM, Window

STATE_MESSAGES = {
    "BATTERY_STATUS": "battery",
    "GLOBAL_POSITION_INT": "location",
    "VFR_HUD": "groundspeed",
    "HEARTBEAT": "flight_mode",
}
"""The state that each message carries; GLOBAL_POSITION_INT carries the heading too and counts once."""
COMMANDS = ("COMMAND_LONG", "COMMAND_INT")
_SEQUENCES = 256
_OVERTAKEN = 8
"""By how many messages a sequence number may come late: an autopilot writes from several threads."""
_STATION_SYSTEM = 245
"""MAVSDK's own system id."""


@dataclass(frozen=True)
class CallPattern:
    """The command by which a call is recognised: its MAV_CMD and the values of its first parameters (None: any)."""

    command: int
    params: tuple[float | None, ...] = ()

    def fits(self, message: dict[str, Any]) -> bool:
        wanted = zip(self.params, (message["param1"], message["param2"], message["param3"]), strict=False)
        return message["command"] == self.command and all(value in (None, found) for value, found in wanted)

    def matches(self) -> pl.Expr:
        """As `fits`, for the messages table."""
        found = pl.col("command") == self.command
        for number, value in enumerate(self.params, 1):
            if value is not None:
                found &= pl.col(f"param{number}") == value
        return found

    def is_of(self, event: dict[str, Any]) -> bool:
        """Whether an autopilot's `command` event is of this call."""
        wanted = zip(self.params, event["params"], strict=False)
        return bool(event["command"] == self.command and all(value in (None, found) for value, found in wanted))


_SET_MODE = 176
_HOLD = CallPattern(_SET_MODE, (None, 4.0, 3.0))
CALLS: dict[str, CallPattern] = {
    "arm": CallPattern(MAV_CMD_ARM, (1.0,)),
    "disarm": CallPattern(MAV_CMD_ARM, (0.0,)),
    "takeoff": CallPattern(22),
    "land": CallPattern(21),
    "goto": CallPattern(192),
    "hold": _HOLD,
    "return": CallPattern(_SET_MODE, (None, 4.0, 5.0)),
    "offboard": CallPattern(_SET_MODE, (None, 6.0)),
    "start_mission": CallPattern(_SET_MODE, (None, 4.0, 4.0)),
}
"""The command of each call (MAV_CMD; DO_SET_MODE with PX4's main and sub mode)."""
BESIDE = {"goto": _HOLD}
"""The command that MAVSDK sends for a call before the call's own."""


def measure(packets: Packets, ways: Ways, window: Window, events: list[dict[str, Any]]) -> Exchange:
    """Follow the mission's calls and states. A call was received if any copy of its command reached its drone."""
    calls = [call for call in calls_in(events, window) if call["command"] in CALLS]
    commands = packets.messages.filter(pl.col("kind").cast(pl.String).is_in(COMMANDS)).with_columns(
        pl.col("link").cast(pl.String)
    )
    leaving = commands.filter(pl.col("link").is_in(ways.leaving(STATION))).to_dicts()
    left_ns = [m["t_ns"] for m in leaving]
    arrived: dict[tuple[Any, ...], list[int]] = {}
    for drone, node in ways.drones.items():
        came = commands.filter(pl.col("link").is_in(ways.entering(node)), pl.col("left_ns").is_not_null())
        for m in came.to_dicts():
            arrived.setdefault((drone, *_key_of(m)), []).append(m["left_ns"])
    frames: Counter[str] = Counter()
    rows: list[tuple[str, int, int | None, int | None, int | None]] = []
    for call, until_ns in zip(calls, _until(calls), strict=True):
        name, drone = str(call["command"]), call["drone"]
        meanwhile = leaving[bisect_left(left_ns, call["t_ns"]) : bisect_left(left_ns, until_ns)]
        own = [m for m in meanwhile if m["target_system"] == drone]
        sent = [m for m in own if CALLS[name].fits(m)]
        frames[name] += len([m for m in own if CALLS[name].fits(m) or (name in BESIDE and BESIDE[name].fits(m))])
        keys = {(drone, *_key_of(m)) for m in sent}
        copies = [at for key in keys for at in arrived.get(key, []) if at >= call["t_ns"]]
        first = sent[0] if sent else {"t_ns": None, "frame": None}
        rows.append((name, drone, first["t_ns"], min(copies, default=None), first["frame"]))
    return Exchange(
        commands=pl.DataFrame(rows, schema=SENT, orient="row"),
        states=_states(packets.messages, ways, window),
        frames_per_call=mean_frames(calls, frames),
    )


def name_messages(messages: pl.DataFrame, drones: Iterable[int]) -> pl.DataFrame:
    """The rows of commands, their ACKs and the five states in the messages table, with the name of each one's kind."""
    kind = pl.col("kind").cast(pl.String)
    rows = messages.with_row_index("row").with_columns(pl.col("row").cast(pl.Int64))
    is_command = kind.is_in(COMMANDS)
    names = [
        pl.when(kind.is_in(list(STATE_MESSAGES)) & pl.col("system").is_in(list(drones))).then(
            kind.replace_strict(STATE_MESSAGES, default=None, return_dtype=pl.String)
        )
    ]
    names += [pl.when(is_command & call.matches()).then(pl.lit(command)) for command, call in CALLS.items()]
    names += [
        pl.when((kind == "COMMAND_ACK") & (pl.col("command") == call.command)).then(pl.lit(f"{command} ack"))
        for command, call in CALLS.items()
    ]
    return rows.select("row", pl.coalesce(names).alias("name")).filter(pl.col("name").is_not_null())


def describe(packets: Packets, ways: Ways, window: Window, shared: bool) -> Mavlink:
    """The `mavlink` part of an attempt: the drones' message mix, the station's messages, the routers' counts.

    In a shared chain a router forwards a message without a target to all its neighbours.
    """
    own = (pl.col("kind").cast(pl.String) == "HEARTBEAT") & ~pl.col("system").is_in([*ways.drones, _STATION_SYSTEM])
    messages = packets.messages.filter(pl.col("protocol").cast(pl.String) == "mavlink").with_columns(
        own.alias("own"), _key()
    )
    in_window = messages.filter(window.entered)
    shares = in_window.with_columns(_share_of_frame(packets, in_window))
    return {
        "streams": _streams(shares, ways, window),
        "commands": _from_station(shares, ways),
        "routers": [
            _router(messages.filter(~pl.col("own")), ways, node, up, window, shared)
            for node in ways.between
            for up in (True, False)
        ],
        "own_heartbeats": int(in_window["own"].sum()),
        "unsent": _unsent(in_window, ways),
    }


def _unsent(messages: pl.DataFrame, ways: Ways) -> dict[str, int]:
    """By drone how many messages never entered its link, by gaps in the sequence numbers: its router or socket had no
    room for them. A gap of 256, or of a few less, does not show."""
    own = messages.filter(_by_its_drone(ways))
    step = (pl.col("sequence").diff() - 1) % _SEQUENCES
    missing = pl.when(step < _SEQUENCES - _OVERTAKEN).then(step).otherwise(step - _SEQUENCES)
    gaps = own.group_by("system", "component", maintain_order=True).agg(missing.fill_null(0).sum().alias("missing"))
    counts = gaps.group_by("system").agg(pl.col("missing").sum()).filter(pl.col("missing") > 0).sort("system")
    return {str(drone): int(count) for drone, count in counts.iter_rows()}


def _states(messages: pl.DataFrame, ways: Ways, window: Window) -> pl.DataFrame:
    """The messages of the states that the drones sent in the window, and when the first copy of each reached gs."""
    states = messages.filter(pl.col("kind").cast(pl.String).is_in(list(STATE_MESSAGES))).with_columns(_key())
    own = states.filter(_by_its_drone(ways)).select(
        pl.col("kind").cast(pl.String).replace_strict(STATE_MESSAGES, return_dtype=pl.String).alias("name"),
        "key",
        "t_ns",
        "frame",
        pl.col("system").alias("drone"),
    )
    arrived = states.filter(
        pl.col("link").cast(pl.String).is_in(ways.entering(STATION)), pl.col("left_ns").is_not_null()
    ).select("key", pl.col("left_ns").alias("arrived_ns"))
    return with_arrivals(own, arrived, ["key"], repeats=False).filter(window.entered).select(SENT.names())


def _streams(shares: pl.DataFrame, ways: Ways, window: Window) -> list[MavlinkStream]:
    """The messages of the drones, measured where they enter the link; one with a target has ` (answer)` in its name."""
    answers = pl.when(pl.col("target_system").fill_null(0) > 0).then(pl.lit(" (answer)")).otherwise(pl.lit(""))
    own = shares.filter(_by_its_drone(ways))
    sent = own.group_by((pl.col("kind").cast(pl.String) + answers).alias("kind")).agg(
        pl.len().alias("count"), pl.col("share").sum().round().cast(pl.Int64).alias("bytes")
    )
    per_drone = window.seconds * own["system"].n_unique()
    return [
        {
            "name": row["kind"],
            "count": row["count"],
            "rate_hz": round(row["count"] / per_drone, 3) if per_drone else 0.0,
            "bytes": row["bytes"],
            "mean_size": round(row["bytes"] / row["count"], 1),
        }
        for row in sent.sort("count", "kind", descending=[True, False]).iter_rows(named=True)
    ]


def _from_station(shares: pl.DataFrame, ways: Ways) -> list[MavlinkMessage]:
    """The messages that leave the ground station; commands by their MAV_CMD."""
    name = pl.concat_str(pl.col("kind").cast(pl.String), pl.col("command"), separator=" ", ignore_nulls=True)
    sent = shares.filter(pl.col("link").cast(pl.String).is_in(ways.leaving(STATION)), ~pl.col("own"))
    counts = sent.group_by(name.alias("name")).agg(
        pl.len().alias("count"), pl.col("share").sum().round().cast(pl.Int64).alias("bytes")
    )
    rows = counts.sort("count", "name", descending=[True, False]).select("name", "count", "bytes").iter_rows()
    return [{"name": name, "count": count, "bytes": size} for name, count, size in rows]


def _router(messages: pl.DataFrame, ways: Ways, node: str, up: bool, window: Window, shared: bool) -> Router:
    """Count the messages that reached a node in the window, those that left it, and those that it dropped."""
    into, out = ways.through(node, up)
    link = pl.col("link").cast(pl.String)
    came = messages.filter(link.is_in(into), window.left)
    went = messages.filter(link.is_in(out))
    for_all = shared & (pl.col("target_system").fill_null(0) == 0)
    dropped = _missing(came.filter(~for_all), went)
    dropped += sum(_missing(came.filter(for_all), went.filter(link == each)) for each in out) if shared else 0
    return {
        "node": node,
        "way": "up" if up else "down",
        "in": len(came),
        "out": len(went.filter(window.entered)),
        "dropped": dropped,
    }


def _missing(first: pl.DataFrame, then: pl.DataFrame) -> int:
    """How many messages of `first` are not in `then`. A key recurs after 256 messages, so its copies are counted."""
    counts = first.group_by("key").len().join(then.group_by("key").len("then"), on="key", how="left")
    return int(
        counts.select((pl.col("len").cast(pl.Int64) - pl.col("then").fill_null(0)).clip(lower_bound=0).sum()).item()
    )


def _by_its_drone(ways: Ways) -> pl.Expr:
    """Whether a message is a drone's own and enters that drone's link."""
    link = pl.col("link").cast(pl.String)
    own = [link.is_in(ways.leaving(node)) & (pl.col("system") == drone) for drone, node in ways.drones.items()]
    return pl.any_horizontal(own) if own else pl.lit(False)


def _share_of_frame(packets: Packets, messages: pl.DataFrame) -> pl.Series:
    """Each message's part of its frame's bytes: all, or a share by length in a datagram with several messages."""
    carried = pl.col("protocol_bytes") + pl.col("payload")
    factor = packets.frames.select(pl.col("size") / carried).to_series().gather(messages["frame"])
    return (factor * messages["bytes"]).alias("share")


def _key() -> pl.Expr:
    """A message's end-to-end key, as one number."""
    key = pl.col("kind").to_physical().cast(pl.Int64)
    for name, bits in (("system", 8), ("component", 8), ("sequence", 8), ("crc", 16)):
        key = key * 2**bits + pl.col(name)
    return key.alias("key")


def _key_of(message: dict[str, Any]) -> tuple[Any, ...]:
    return tuple(message[name] for name in ("kind", "system", "component", "sequence", "crc"))


def _until(calls: list[dict[str, Any]]) -> list[int]:
    """For each call the time of the next call of its command to its drone; frames from then on are not its own."""
    following: dict[tuple[Any, Any], int] = {}
    found = []
    for call in reversed(calls):
        key = call["command"], call["drone"]
        found.append(following.get(key, 2**63 - 1))
        following[key] = int(call["t_ns"])
    return found[::-1]
