"""The messages that are a kind's own: those that carry it, requests for it, and the answers to both."""

from __future__ import annotations

from collections.abc import Collection

import polars as pl
from pymavlink.dialects.v20 import common

from .mavlink import BESIDE, CALLS, COMMANDS
from .mqttxt import kind_of, state_keys
from .ways import STATION, Ways

STATE_MESSAGE = {
    "battery": "BATTERY_STATUS",
    "location": "GLOBAL_POSITION_INT",
    "groundspeed": "VFR_HUD",
    "flight_mode": "HEARTBEAT",
    "heading": "GLOBAL_POSITION_INT",
}
"""The message that carries each state over MAVLink; one carries both location and heading."""
SETPOINTS = ("SET_POSITION_TARGET_LOCAL_NED", "SET_POSITION_TARGET_GLOBAL_INT", "SET_ATTITUDE_TARGET")
REQUEST = "request"
"""The name of a request for a stream: SET_MESSAGE_INTERVAL, or MQTT-XT's command `stream`."""
_ASKS = "stream"
_INTERVAL = int(common.MAV_CMD_SET_MESSAGE_INTERVAL)
_OWN = pl.Schema({"row": pl.Int64(), "name": pl.String()})


def own_mavlink(messages: pl.DataFrame, name: str, drones: Collection[int]) -> pl.DataFrame:
    """`row` and `name` of a kind's own rows among `messages`, which have the column `row`.

    The names are the kind's, `NAME ack`, and for a state `request` and `request ack`. An extra command that MAVSDK
    sends with a call is `beside`, with `beside ack`.
    """
    kind, drone = pl.col("kind").cast(pl.String), list(drones)
    commands = kind.is_in(COMMANDS) & pl.col("target_system").is_in(drone)
    acks = (kind == "COMMAND_ACK") & pl.col("system").is_in(drone)
    if name in CALLS:
        call, beside = CALLS[name], BESIDE.get(name)
        names = [pl.when(commands & call.matches()).then(pl.lit(name))]
        names += [pl.when(acks & (pl.col("command") == call.command)).then(pl.lit(f"{name} ack"))]
        if beside is not None:
            names += [pl.when(commands & beside.matches()).then(pl.lit("beside"))]
            names += [pl.when(acks & (pl.col("command") == beside.command)).then(pl.lit("beside ack"))]
    else:
        number = next(n for n, known in common.mavlink_map.items() if known.msgname == STATE_MESSAGE[name])
        carries = (kind == STATE_MESSAGE[name]) & pl.col("system").is_in(drone)
        asks = commands & (pl.col("command") == _INTERVAL) & (pl.col("param1") == number)
        names = [pl.when(carries).then(pl.lit(name)), pl.when(asks).then(pl.lit(REQUEST))]
        names += [pl.when(acks & (pl.col("command") == _INTERVAL)).then(pl.lit(f"{REQUEST} ack"))]
    return messages.select("row", pl.coalesce(names).alias("name")).filter(pl.col("name").is_not_null())


def own_mqttxt(messages: pl.DataFrame, name: str, ways: Ways) -> pl.DataFrame:
    """As `own_mavlink`, over MQTT-XT: the kind's name, `NAME result`, `request` and `request result`.

    A bundle is a state's own if it contains that state.
    """
    from_drones = {link for node in ways.drones.values() for link in ways.leaving(node)}
    publishes = messages.filter(pl.col("body").is_not_null() & pl.col("topic").is_not_null())
    found = []
    for row, link, topic, body in publishes.select("row", pl.col("link").cast(pl.String), "topic", "body").iter_rows():
        what = kind_of(topic, body)
        if what == "states":
            inner = {state for _, state, _ in state_keys(topic, body, link not in from_drones)}
            found += [(row, name)] if name in inner else []
        elif what in (name, f"{name} result"):
            found.append((row, what))
        elif what in (_ASKS, f"{_ASKS} result") and name in STATE_MESSAGE:
            found.append((row, what.replace(_ASKS, REQUEST)))
    return pl.DataFrame(found, schema=_OWN, orient="row")


def setpoints(messages: pl.DataFrame, ways: Ways) -> pl.DataFrame:
    """The rows of set-points, which only MAVLink's side sends over links."""
    kind = pl.col("kind").cast(pl.String)
    leaving_drones = [link for node in ways.drones.values() for link in ways.leaving(node)]
    upwards = pl.col("link").cast(pl.String).is_in([*leaving_drones, *ways.entering(STATION)])
    return messages.filter(kind.is_in(SETPOINTS) & ~upwards)
