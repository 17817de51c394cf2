"""MQTT-XT end to end: commands by (ground station's session, seq), states by (drone, state, origin's stamp)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any

import polars as pl

from mqttxt.errors import PayloadError
from mqttxt.messages import CommandMessage
from mqttxt.wire.bundles import DroneBundle, FogBundle, states_of
from mqttxt.wire.codec import decode
from mqttxt.wire.states import decode_state

from ..packets import Packets
from .exchange import Exchange, calls_in, delays_ms, mean_frames
from .traffic import lost_share
from .ways import STATION, Ways
from .window import Window, is_command

CommandKey = tuple[int, int, str, int]
"""GS session, seq, name, and the drone: a broadcast is a command to each drone of its fog."""
StateKey = tuple[str, str, int]


def measure(packets: Packets, ways: Ways, window: Window, events: list[dict[str, Any]]) -> Exchange:
    """What the mission's PUBLISHes say."""
    publishes = packets.messages.filter(pl.col("body").is_not_null()).with_columns(pl.col("link").cast(pl.String))
    leaving = publishes.filter(window.entered, pl.col("link").is_in(ways.leaving(STATION)))
    sent, frames = _commands_sent(leaving, ways)
    received = _commands_received(publishes, ways)
    leaving_drones = [link for node in ways.drones.values() for link in ways.leaving(node)]
    states_sent = _states(publishes.filter(window.entered, pl.col("link").is_in(leaving_drones)), relayed=False)
    arrived = publishes.filter(pl.col("left_ns").is_not_null(), pl.col("link").is_in(ways.entering(STATION)))
    return Exchange(
        commands_sent=len(sent),
        commands_lost=lost_share(sent, received),
        states_sent=len(states_sent),
        states_lost=lost_share(states_sent, _states(arrived, relayed=True)),
        delay_ms=delays_ms([(key[2], sent[key], received[key]) for key in sorted(sent) if key in received]),
        frames_per_call=mean_frames(calls_in(events, window), frames),
    )


def _commands_sent(publishes: pl.DataFrame, ways: Ways) -> tuple[dict[CommandKey, int], Counter[str]]:
    """When each command first left, and how many frames carried each kind of command."""
    sent: dict[CommandKey, int] = {}
    frames: Counter[str] = Counter()
    columns = ("t_ns", "topic", "body", "copies")
    for t_ns, topic, body, copies in publishes.filter(is_command()).select(columns).iter_rows():
        command = _command(body)
        if command is not None:
            frames[command[2]] += copies
            for drone in _addressed(topic, ways):
                sent.setdefault((*command, drone), t_ns)
    return sent, frames


def _commands_received(publishes: pl.DataFrame, ways: Ways) -> dict[CommandKey, int]:
    """When the first copy of each command reached its drone."""
    found: dict[CommandKey, int] = {}
    drone_of = {link: drone for drone, node in ways.drones.items() for link in ways.entering(node)}
    arrived = publishes.filter(is_command(), pl.col("left_ns").is_not_null(), pl.col("link").is_in(list(drone_of)))
    for left_ns, link, body in arrived.sort("left_ns").select("left_ns", "link", "body").iter_rows():
        command = _command(body)
        if command is not None:
            found.setdefault((*command, drone_of[link]), left_ns)
    return found


def _addressed(topic: str, ways: Ways) -> list[int]:
    """The drones that a command's topic means: `fogX/droneY/commands` one, `fogX/commands` all of the fog."""
    fog, *rest = topic.split("/")
    if len(rest) == 2:
        return [drone for drone in ways.drones if rest[0] == f"drone{drone}"]
    return ways.drones_of(fog)


def _states(publishes: pl.DataFrame, relayed: bool) -> set[StateKey]:
    rows = publishes.filter(pl.col("topic").is_not_null()).select("topic", "body").iter_rows()
    return {key for topic, body in rows for key in _state_keys(topic, body, relayed)}


def _command(payload: bytes) -> tuple[int, int, str] | None:
    """(GS session, seq) and the command's name: what names a command from end to end."""
    try:
        message = decode(CommandMessage, payload)
    except PayloadError:
        return None
    return (message.gs_session, message.seq, message.command.name)


def _state_keys(topic: str, payload: bytes, relayed: bool) -> Iterator[StateKey]:
    """(drone, state, origin stamp) of each state in a message: what names a state from end to end."""
    levels = topic.split("/")
    try:
        if len(levels) >= 3 and levels[-2] == "state":
            yield (levels[-3], levels[-1], decode_state(levels[-1], payload, relayed).stamp)
        elif len(levels) >= 2 and levels[-1] == "states" and relayed:
            for drone, message in states_of(decode(FogBundle, payload)):
                yield (f"drone{drone}", message.state.name, message.stamp)
        elif len(levels) >= 2 and levels[-1] == "states":
            bundle = decode(DroneBundle, payload)
            for bundled in bundle.states:
                yield (levels[-2], bundled.state.name, bundle.stamp)
    except PayloadError:
        return
