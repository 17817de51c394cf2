"""MQTT-XT end to end: commands by (ground station's session, seq), states by (drone, state, origin's stamp)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from typing import Any

import polars as pl

from mqttxt.errors import PayloadError
from mqttxt.protocol.bundles import DroneBundle, FogBundle, states_of
from mqttxt.protocol.codec import decode
from mqttxt.protocol.messages import CommandMessage, Presence
from mqttxt.protocol.state_payload import decode_state

from ..packets import Packets
from ..packets.signed import by_drone, inside
from .exchange import SENT, Exchange, calls_in, mean_frames, with_arrivals
from .ways import STATION, Ways
from .window import Window, is_command

CommandKey = tuple[int, int, str, int]
"""GS session, seq, name, and the drone: a broadcast is a command to each drone of its fog."""
_STATE = pl.Schema({"drone": pl.Int64(), "name": pl.String(), "stamp": pl.Int64()})
"""The columns that identify a state from end to end."""
_CALLED = {"resume": "start_mission"}
"""Commands by the calls that cause them: a gateway sends MAVSDK's start of a mission as `resume` (docs/gateway.md)."""


def measure(packets: Packets, ways: Ways, window: Window, events: list[dict[str, Any]]) -> Exchange:
    """Follow commands and states by the mission's PUBLISHes. A call without a frame that left the station is lost."""
    publishes = packets.messages.filter(pl.col("body").is_not_null()).with_columns(pl.col("link").cast(pl.String))
    from_station = publishes.filter(pl.col("link").is_in(ways.leaving(STATION)))
    leaving = from_station.filter(window.entered)
    sent, frames = _commands_sent(leaving, ways)
    frames += _selects_sent(leaving)
    for left_as, called in _CALLED.items():
        frames[called] += frames.pop(left_as, 0)
    received = _commands_received(publishes, ways)
    rows: list[tuple[str, int, int | None, int | None, int | None]] = [
        (key[2], key[3], left_ns, received.get(key), row) for key, (left_ns, row) in sorted(sent.items())
    ]
    calls = calls_in(events, window)
    rows += [(name, drone, None, None, None) for name, drone in _unsent(calls, sent, ways)]
    leaving_drones = [link for node in ways.drones.values() for link in ways.leaving(node)]
    own = _states(publishes.filter(pl.col("link").is_in(leaving_drones)), "t_ns", relayed=False)
    came = publishes.filter(pl.col("left_ns").is_not_null(), pl.col("link").is_in(ways.entering(STATION)))
    arrived = _states(came, "left_ns", relayed=True).rename({"left_ns": "arrived_ns"}).drop("frame")
    states = with_arrivals(own, arrived, _STATE.names(), repeats=True)
    return Exchange(
        commands=pl.DataFrame(rows, schema=SENT, orient="row"),
        states=states.filter(window.entered).select(SENT.names()),
        frames_per_call=mean_frames(calls, frames),
        left_ns=_left_ns(from_station),
    )


def _left_ns(from_station: pl.DataFrame) -> int | None:
    """When the ground station published that it is down (R9.3), after which no fog sends it states; None if never."""
    said = from_station.filter(pl.col("topic").str.contains(r"^gs/[^/]+/reachable$")).sort("t_ns")
    for t_ns, body in said.select("t_ns", "body").iter_rows():
        try:
            if not decode(Presence, inside(body)).up:
                return int(t_ns)
        except PayloadError:
            continue
    return None


def name_messages(messages: pl.DataFrame, drones: Iterable[int]) -> pl.DataFrame:
    """The rows of commands, their results and states in the messages table, with the name of each one's kind."""
    rows = messages.with_row_index("row").filter(pl.col("body").is_not_null() & pl.col("topic").is_not_null())
    found = []
    for row, topic, body in rows.select("row", "topic", "body").iter_rows():
        name = kind_of(topic, body)
        found += [(row, name)] if name is not None else []
    return pl.DataFrame(found, schema={"row": pl.Int64(), "name": pl.String()}, orient="row")


def kind_of(topic: str, body: bytes) -> str | None:
    """The kind of a PUBLISH: a command's name, `NAME result`, a state's name, or `states` for a bundle; None: other."""
    *before, last = topic.split("/")
    if last == "commands":
        return next((name for (_, _, name), _ in _commands(body)), None)
    if last == "states":
        return "states"
    kind = before[-1] if before else ""
    return {"state": last, "commands_result": f"{last} result"}.get(kind)


def _unsent(
    calls: list[dict[str, Any]], sent: dict[CommandKey, tuple[int, int]], ways: Ways
) -> Iterator[tuple[str, int]]:
    """(command, drone) of each call whose command never left the ground station.

    A command that left belongs to the last earlier call of that command to that drone.
    """
    times: dict[tuple[str, int], list[int]] = {}
    for (_, _, name, drone), (t_ns, _) in sent.items():
        times.setdefault((_CALLED.get(name, name), drone), []).append(t_ns)
    made: dict[tuple[str, int], list[int]] = {}
    for call in calls:
        targets = [call["drone"]] if call["drone"] is not None else ways.drones_of(f"fog{call['fog']}")
        for drone in targets:
            made.setdefault((str(call["command"]), drone), []).append(int(call["t_ns"]))
    for key, asked in made.items():
        for number, t_ns in enumerate(asked):
            until = asked[number + 1] if number + 1 < len(asked) else 2**63
            if not any(t_ns <= left < until for left in times.get(key, [])):
                yield key


def _commands_sent(publishes: pl.DataFrame, ways: Ways) -> tuple[dict[CommandKey, tuple[int, int]], Counter[str]]:
    """When each command first left and in which frame, and how many frames carried each kind of command."""
    sent: dict[CommandKey, tuple[int, int]] = {}
    frames: Counter[str] = Counter()
    columns = ("t_ns", "frame", "topic", "body", "copies")
    for t_ns, row, topic, body, copies in publishes.filter(is_command()).select(columns).iter_rows():
        commands = list(_commands(body))
        frames.update(dict.fromkeys((name for (_, _, name), _ in commands), copies))
        for command, signed_for in commands:
            for drone in _addressed(topic, ways) if signed_for is None else (signed_for,):
                sent.setdefault((*command, drone), (t_ns, row))
    return sent, frames


def _selects_sent(publishes: pl.DataFrame) -> Counter[str]:
    """How many frames asked fogs for the best drone of each kind of command, or chose it (`fogX/commands/C`).

    The fogs decide which drone gets such a command, so it is not counted among the commands sent and lost.
    """
    levels = pl.col("topic").str.split("/").list
    asked = publishes.filter((levels.get(-2, null_on_oob=True) == "commands").fill_null(False))
    counts = asked.group_by(levels.last().alias("name")).agg(pl.col("copies").sum())
    return Counter(dict(counts.iter_rows()))


def _commands_received(publishes: pl.DataFrame, ways: Ways) -> dict[CommandKey, int]:
    """When the first copy of each command reached its drone."""
    found: dict[CommandKey, int] = {}
    drone_of = {link: drone for drone, node in ways.drones.items() for link in ways.entering(node)}
    arrived = publishes.filter(is_command(), pl.col("left_ns").is_not_null(), pl.col("link").is_in(list(drone_of)))
    for left_ns, link, body in arrived.sort("left_ns").select("left_ns", "link", "body").iter_rows():
        for command, _ in _commands(body):
            found.setdefault((*command, drone_of[link]), left_ns)
    return found


def _addressed(topic: str, ways: Ways) -> list[int]:
    """The drones that a command's topic addresses: `fogX/droneY/commands` one, `fogX/commands` all of the fog."""
    fog, *rest = topic.split("/")
    if len(rest) == 2:
        return [drone for drone in ways.drones if rest[0] == f"drone{drone}"]
    return ways.drones_of(fog)


def _states(publishes: pl.DataFrame, time: str, relayed: bool) -> pl.DataFrame:
    """A row for each state in the PUBLISHes: its key (`_STATE`), the frame, and the column `time`."""
    rows = [
        (*key, at, row)
        for at, row, topic, body in publishes.filter(pl.col("topic").is_not_null())
        .select(time, "frame", "topic", "body")
        .iter_rows()
        for key in state_keys(topic, body, relayed)
    ]
    return pl.DataFrame(rows, schema={**_STATE, time: pl.Int64(), "frame": pl.Int64()}, orient="row")


def _commands(body: bytes) -> Iterator[tuple[tuple[int, int, str], int | None]]:
    """(GS session, seq, name) of each command in a PUBLISH, which identifies it from end to end, and the drone that it
    is signed for; None where the topic addresses it.
    """
    drone: int | None
    for drone, payload in by_drone(body).items() or ((None, inside(body)),):
        try:
            message = decode(CommandMessage, payload)
        except PayloadError:
            continue
        yield (message.gs_session, message.seq, message.command.name), drone


def state_keys(topic: str, payload: bytes, relayed: bool) -> Iterator[tuple[int, str, int]]:
    """(drone, state, origin stamp) of each state in a message, which identifies the state from end to end."""
    levels = topic.split("/")
    try:
        if len(levels) >= 3 and levels[-2] == "state":
            drone = _drone(levels[-3])
            stamp = decode_state(levels[-1], payload, relayed).stamp
            yield from [(drone, levels[-1], stamp)] if drone is not None else []
        elif len(levels) >= 2 and levels[-1] == "states" and relayed:
            for number, message in states_of(decode(FogBundle, payload)):
                yield (number, message.state.name, message.stamp)
        elif len(levels) >= 2 and levels[-1] == "states":
            bundle = decode(DroneBundle, payload)
            drone = _drone(levels[-2])
            yield from [(drone, each.state.name, bundle.stamp) for each in bundle.states if drone is not None]
    except PayloadError:
        return


def _drone(level: str) -> int | None:
    """The number in `droneY`; None for any other level."""
    number = level.removeprefix("drone")
    return int(number) if number.isascii() and number.isdecimal() and number != level else None
