"""MAVLink end to end: calls by the commands that they sent, states and routers by a message's own key."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any

import polars as pl

from ..packets import Packets
from .exchange import Exchange, calls_in, delays_ms, mean_frames
from .ways import STATION, Ways
from .window import MAV_CMD_ARM, Window

STATE_MESSAGES = ("BATTERY_STATUS", "GLOBAL_POSITION_INT", "VFR_HUD", "HEARTBEAT")
"""What carries battery; location and heading; groundspeed; flight mode."""
_COMMANDS = ("COMMAND_LONG", "COMMAND_INT")
_STATION_SYSTEM = 245
"""MAVSDK's own system id."""


@dataclass(frozen=True)
class _Call:
    """How a call is told by its command: MAV_CMD, and what its first parameters must be (None: anything)."""

    command: int
    params: tuple[float | None, ...] = ()

    def fits(self, message: dict[str, Any]) -> bool:
        wanted = zip(self.params, (message["param1"], message["param2"], message["param3"]), strict=False)
        return message["command"] == self.command and all(value in (None, found) for value, found in wanted)


_SET_MODE = 176
_HOLD = _Call(_SET_MODE, (None, 4.0, 3.0))
CALLS: dict[str, _Call] = {
    "arm": _Call(MAV_CMD_ARM, (1.0,)),
    "disarm": _Call(MAV_CMD_ARM, (0.0,)),
    "takeoff": _Call(22),
    "land": _Call(21),
    "goto": _Call(192),
    "hold": _HOLD,
    "return": _Call(_SET_MODE, (None, 4.0, 5.0)),
    "offboard": _Call(_SET_MODE, (None, 6.0)),
}
"""The command of each call (MAV_CMD; DO_SET_MODE with PX4's main and sub mode)."""
_BESIDE = {"goto": _HOLD}
"""What MAVSDK sends for a call before the command itself."""


def measure(packets: Packets, ways: Ways, window: Window, events: list[dict[str, Any]]) -> Exchange:
    """What the mission's messages say. A call was received if any copy of its command reached its drone."""
    calls = [call for call in calls_in(events, window) if call["command"] in CALLS]
    commands = packets.messages.filter(pl.col("kind").cast(pl.String).is_in(_COMMANDS)).with_columns(
        pl.col("link").cast(pl.String)
    )
    leaving = commands.filter(pl.col("link").is_in(ways.leaving(STATION))).to_dicts()
    arrived = {
        drone: commands.filter(pl.col("link").is_in(ways.entering(node)), pl.col("left_ns").is_not_null()).to_dicts()
        for drone, node in ways.drones.items()
    }
    frames: Counter[str] = Counter()
    pairs: list[tuple[str, int, int]] = []
    for number, call in enumerate(calls):
        name, drone, until_ns = str(call["command"]), call["drone"], _until(calls, number)
        own = [m for m in leaving if m["target_system"] == drone and call["t_ns"] <= m["t_ns"] < until_ns]
        sent = [m for m in own if CALLS[name].fits(m)]
        frames[name] += len([m for m in own if CALLS[name].fits(m) or (name in _BESIDE and _BESIDE[name].fits(m))])
        keys = {_key_of(m) for m in sent}
        copies = [m["left_ns"] for m in arrived.get(drone, []) if _key_of(m) in keys and m["left_ns"] >= call["t_ns"]]
        if copies:
            pairs.append((name, sent[0]["t_ns"], min(copies)))
    states_sent, states_lost = _states(packets.messages, ways, window)
    return Exchange(
        commands_sent=len(calls),
        commands_lost=1 - len(pairs) / len(calls) if calls else None,
        states_sent=states_sent,
        states_lost=states_lost / states_sent if states_sent else None,
        delay_ms=delays_ms(pairs),
        frames_per_call=mean_frames(calls, frames),
    )


def describe(packets: Packets, ways: Ways, window: Window, shared: bool) -> dict[str, Any]:
    """The `mavlink` part of an attempt: the message mix, what was commanded, what each router passed on.

    In a shared chain a router passes what names no target on to all its neighbours.
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
            {
                "node": node,
                "way": "up" if up else "down",
                **_passed_on(messages.filter(~pl.col("own")), ways.through(node, up), window, shared),
            }
            for node in ways.between
            for up in (True, False)
        ],
        "own_heartbeats": int(in_window["own"].sum()),
    }


def _states(messages: pl.DataFrame, ways: Ways, window: Window) -> tuple[int, int]:
    """How many messages of the states the drones sent in the window, and how many of them never reached gs."""
    states = messages.filter(pl.col("kind").cast(pl.String).is_in(STATE_MESSAGES)).with_columns(_key())
    sent = states.filter(window.entered, _by_its_drone(ways))
    arrived = states.filter(
        pl.col("link").cast(pl.String).is_in(ways.entering(STATION)), pl.col("left_ns") >= window.start_ns
    )
    return len(sent), _missing(sent, arrived)


def _streams(shares: pl.DataFrame, ways: Ways, window: Window) -> list[dict[str, Any]]:
    """What the drones send, measured where it enters the link; what answers somebody is named so."""
    answers = pl.when(pl.col("target_system").fill_null(0) > 0).then(pl.lit(" (answer)")).otherwise(pl.lit(""))
    sent = (
        shares.filter(_by_its_drone(ways))
        .group_by((pl.col("kind").cast(pl.String) + answers).alias("kind"))
        .agg(pl.len().alias("count"), pl.col("share").sum().round().cast(pl.Int64).alias("bytes"))
    )
    per_drone = window.seconds * len(ways.drones)
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


def _from_station(shares: pl.DataFrame, ways: Ways) -> list[dict[str, Any]]:
    """What leaves the ground station; commands by their number."""
    name = pl.concat_str(pl.col("kind").cast(pl.String), pl.col("command"), separator=" ", ignore_nulls=True)
    sent = shares.filter(pl.col("link").cast(pl.String).is_in(ways.leaving(STATION)), ~pl.col("own"))
    counts = sent.group_by(name.alias("name")).agg(
        pl.len().alias("count"), pl.col("share").sum().round().cast(pl.Int64).alias("bytes")
    )
    return counts.sort("count", "name", descending=[True, False]).to_dicts()


def _passed_on(
    messages: pl.DataFrame, through: tuple[list[str], list[str]], window: Window, shared: bool
) -> dict[str, int]:
    """Messages that came to a node in the window, went on from it, and never did though they should have."""
    into, out = through
    link = pl.col("link").cast(pl.String)
    came = messages.filter(link.is_in(into), window.left)
    went = messages.filter(link.is_in(out))
    for_all = shared & (pl.col("target_system").fill_null(0) == 0)
    dropped = _missing(came.filter(~for_all), went)
    dropped += sum(_missing(came.filter(for_all), went.filter(link == each)) for each in out) if shared else 0
    return {"in": len(came), "out": len(went.filter(window.entered)), "dropped": dropped}


def _missing(first: pl.DataFrame, then: pl.DataFrame) -> int:
    """How many messages of `first` are not in `then`. A key comes again after 256 messages, so copies are counted."""
    counts = first.group_by("key").len().join(then.group_by("key").len("then"), on="key", how="left")
    return int(
        counts.select((pl.col("len").cast(pl.Int64) - pl.col("then").fill_null(0)).clip(lower_bound=0).sum()).item()
    )


def _by_its_drone(ways: Ways) -> pl.Expr:
    """Of a message: whether it is a drone's own and enters that drone's link."""
    link = pl.col("link").cast(pl.String)
    own = [link.is_in(ways.leaving(node)) & (pl.col("system") == drone) for drone, node in ways.drones.items()]
    return pl.any_horizontal(own) if own else pl.lit(False)


def _share_of_frame(packets: Packets, messages: pl.DataFrame) -> pl.Series:
    """The bytes of its frame that each message has to answer for: all, or its part of a datagram with several."""
    carried = pl.col("protocol_bytes") + pl.col("payload")
    factor = packets.frames.select(pl.col("size") / carried).to_series().gather(messages["frame"])
    return (factor * messages["bytes"]).alias("share")


def _key() -> pl.Expr:
    """Of a message: what names it from end to end, as one number."""
    key = pl.col("kind").to_physical().cast(pl.Int64)
    for name, bits in (("system", 8), ("component", 8), ("sequence", 8), ("crc", 16)):
        key = key * 2**bits + pl.col(name)
    return key.alias("key")


def _key_of(message: dict[str, Any]) -> tuple[Any, ...]:
    return tuple(message[name] for name in ("kind", "system", "component", "sequence", "crc"))


def _until(calls: list[dict[str, Any]], number: int) -> int:
    """When the next call of the same command to the same drone is asked for; its frames are no longer this one's."""
    one = calls[number]
    later = [c for c in calls[number + 1 :] if (c["command"], c["drone"]) == (one["command"], one["drone"])]
    return int(later[0]["t_ns"]) if later else 2**63 - 1
