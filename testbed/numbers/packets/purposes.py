"""The purpose of a message, on either side, by which traffic is split."""

from __future__ import annotations

from collections.abc import Iterable

import polars as pl

PURPOSES = ("command", "result", "state", "presence", "sensor", "upkeep", "acknowledgement", "other")
"""Commands to drones, with the missions and logs that they name; their results; what drones send unasked; presence and
rankings; sensors' readings; upkeep of connections and clocks; acknowledgements of TCP, of MQTT and of readings; others.
"""
_COMMAND, _RESULT, _STATE, _PRESENCE, _SENSOR, _UPKEEP, _ACKNOWLEDGEMENT, _OTHER = PURPOSES
_TOPIC_ENDS = {
    "commands": _COMMAND,
    "states": _STATE,
    "sensor_ack": _ACKNOWLEDGEMENT,
    **dict.fromkeys(("reachable", "QoDS", "PSMI", "birth", "stations"), _PRESENCE),
    **dict.fromkeys(("clock", "init_connect", "control"), _UPKEEP),
    "bulk": _COMMAND,
    "bulk_answer": _RESULT,
}
_TOPIC_MIDDLES = {"commands": _COMMAND, "commands_result": _RESULT, "state": _STATE, "mavlink": _STATE}
_ACKS = ("puback", "pubrec", "pubrel", "pubcomp")
_MAVLINK = {
    **dict.fromkeys(("COMMAND_LONG", "COMMAND_INT", "COMMAND_CANCEL", "SET_MODE", "MANUAL_CONTROL"), _COMMAND),
    "SET_ATTITUDE_TARGET": _COMMAND,
    "SET_POSITION_TARGET_LOCAL_NED": _COMMAND,
    "SET_POSITION_TARGET_GLOBAL_INT": _COMMAND,
    "COMMAND_ACK": _RESULT,
    **dict.fromkeys(("PING", "TIMESYNC", "SYSTEM_TIME", "AUTOPILOT_VERSION", "PROTOCOL_VERSION"), _UPKEEP),
    **dict.fromkeys(("REQUEST_DATA_STREAM", "LINK_NODE_STATUS", "COMPONENT_INFORMATION"), _UPKEEP),
    **dict.fromkeys(("PARAM_REQUEST_READ", "PARAM_REQUEST_LIST", "PARAM_VALUE", "PARAM_SET"), _UPKEEP),
    **dict.fromkeys(("PARAM_EXT_REQUEST_READ", "PARAM_EXT_VALUE", "COMPONENT_METADATA"), _UPKEEP),
}
_UNASKED = ("MISSION_CURRENT", "MISSION_ITEM_REACHED")
_CARRIED = r"^(MISSION|LOG|FILE_TRANSFER)_"
"""What carries missions and logs, in either direction: a part of a command from a station, of a result from a drone."""
_ASKING = (511, 512, 519, 520, 521)
"""MAV_CMDs by which a station only requests messages of a vehicle: SET_MESSAGE_INTERVAL, REQUEST_MESSAGE, and
REQUEST_*_VERSION, _CAPABILITIES. MAVSDK sends them unasked whenever a vehicle appears or reappears.
"""


def of_topic(topic: str | None) -> str:
    """The purpose of a PUBLISH by its topic (MQTT-XT, section 2)."""
    levels = (topic or "").split("/")
    if levels[-1] in _TOPIC_ENDS:
        return _TOPIC_ENDS[levels[-1]]
    before = levels[-2] if len(levels) > 1 else ""
    if before in _TOPIC_MIDDLES:
        return _TOPIC_MIDDLES[before]
    is_sensor = before.startswith("sensor") and before.removeprefix("sensor").isdecimal()
    return _SENSOR if is_sensor else _OTHER


def of_packet(kind: str, topic: str | None) -> str:
    """The purpose of an MQTT packet."""
    if kind == "publish":
        return of_topic(topic)
    return _ACKNOWLEDGEMENT if kind in _ACKS else _UPKEEP


def of_messages(messages: pl.DataFrame, drones: Iterable[int]) -> pl.Series:
    """The purpose of each row of the messages table. A HEARTBEAT is a state only if it is a drone's; a command that an
    autopilot sends, as PX4 does to components that it may have, is one too: nobody asked for it."""
    kind = pl.col("kind").cast(pl.String)
    is_mavlink = pl.col("protocol").cast(pl.String) == "mavlink"
    own = pl.col("system").is_in(list(drones))
    mavlink = (
        pl.when((kind == "HEARTBEAT") & ~own)
        .then(pl.lit(_UPKEEP))
        .when(kind.is_in(["COMMAND_LONG", "COMMAND_INT", "COMMAND_ACK"]) & pl.col("command").is_in(_ASKING))
        .then(pl.lit(_UPKEEP))
        .when(own & kind.is_in([name for name, purpose in _MAVLINK.items() if purpose == _COMMAND]))
        .then(pl.lit(_STATE))
        .when(kind.str.contains(_CARRIED) & ~kind.is_in(_UNASKED))
        .then(pl.when(own).then(pl.lit(_RESULT)).otherwise(pl.lit(_COMMAND)))
        .otherwise(kind.replace_strict(_MAVLINK, default=_STATE, return_dtype=pl.String))
    )
    topics = messages["topic"].unique(maintain_order=True).to_list()
    by_topic = pl.col("topic").replace_strict({t: of_topic(t) for t in topics if t}, default=_OTHER)
    mqtt = (
        pl.when(kind == "publish")
        .then(by_topic if any(topics) else pl.lit(_OTHER))
        .when(kind.is_in(_ACKS))
        .then(pl.lit(_ACKNOWLEDGEMENT))
        .otherwise(pl.lit(_UPKEEP))
    )
    found = messages.select(pl.when(is_mavlink).then(mavlink).otherwise(mqtt).cast(pl.Categorical()).alias("purpose"))
    return found.to_series()
