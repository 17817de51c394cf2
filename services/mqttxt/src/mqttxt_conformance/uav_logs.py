"""Rules of a UAV client about its autopilot's flight logs (section 18)."""

from __future__ import annotations

import asyncio
import random

from mqttxt.protocol.bulk import Get
from mqttxt.protocol.commands import Disarm

from .autopilot import ARM, Written
from .registry import expect, rule
from .uav_kit import UavKit
from .uav_objects import Transfer, in_control, rows_of

_LIST_S, _LOG_S = 12.0, 30.0
_TIME_S = 1_700_000_000
_SHORT, _LONG = 5_000, 150_000
_MOST_COUNT = 64 * 90
_MOST_BYTES_S = 65_536
_WAY_MS = 2000
_SURELY_MS = 1000
"""Requests within this time behind a command are too soon on any machine."""


def _asked(kit: UavKit, mark: int) -> list[Written]:
    """The requests for logs that were written since `mark`, without LOG_REQUEST_END."""
    kinds = ("LOG_REQUEST_LIST", "LOG_REQUEST_DATA")
    return [one for one in kit.autopilot.written[mark:] if one.message.get_type() in kinds]


def _fill(kit: UavKit) -> None:
    noise = random.Random(18)
    sizes = {1: _SHORT, 2: _LONG}
    kit.autopilot.logs.logs = {number: (_TIME_S + number, noise.randbytes(size)) for number, size in sizes.items()}


@rule("uav", "R18.1", "R18.3")
async def lists_logs_disarmed_alone(kit: UavKit) -> str:
    """The list has number, size and time of each log; an armed autopilot is asked for nothing: `refused(armed)`."""
    await kit.calm()
    _fill(kit)
    transfer = Transfer(kit, await in_control(kit), "logs")
    kit.autopilot.armed = True
    await kit.show()
    mark = len(kit.autopilot.written)
    name, fields = await transfer.newest(_LIST_S)
    expect(not _asked(kit, mark), f"armed: {len(_asked(kit, mark))} requests for logs were written")
    expect((name, fields[:1]) == ("refused", ["armed"]), f"armed: came {name} {fields}, expected refused(armed)")
    await kit.calm()
    rows = rows_of(await transfer.whole(await transfer.newest(_LIST_S)), 1)
    own = [[number, len(data), time_s] for number, (time_s, data) in kit.autopilot.logs.logs.items()]
    expect(rows == own, f"the list {rows}, expected {own}")
    return f"armed: refused(armed), nothing was asked for; disarmed: {rows}"


@rule("uav", "R18.2", "R18.4", "R18.5", "R18.8", "R18.10")
async def commands_go_before_logs(kit: UavKit) -> str:
    """A command breaks the reading of a log off for 2 s; what is asked for is bound; then the log is there, whole."""
    await kit.calm()
    _fill(kit)
    number, (time_s, data) = 2, kit.autopilot.logs.logs[2]
    session = await in_control(kit)
    transfer = Transfer(kit, session, f"log.{number}.{len(data)}.{time_s}")
    mark = len(kit.autopilot.written)
    await transfer.ask(Get(0, 0))
    reading = await kit.tap.until(lambda: kit.autopilot.of_type(mark, "LOG_REQUEST_DATA"), _LIST_S)
    expect(reading, f"log {number} was not read within {_LIST_S:g} s")
    message, began = kit.command(Disarm(), gs_session=session), len(kit.autopilot.written)
    kit.publish(message)
    words = await kit.outcome(message)
    await asyncio.sleep(_WAY_MS / 1000)
    behind = kit.autopilot.written[began:]
    at = next((index for index, one in enumerate(behind) if one.command == ARM), None)
    expect(at is not None, f"disarm while a log is read: not written; came {words}")
    kinds, flown_ms = [one.message.get_type() for one in behind[:at]], behind[at or 0].at_ms
    expect("LOG_REQUEST_END" in kinds, f"disarm was written before LOG_REQUEST_END; came {words}")
    gaps = [one.at_ms - flown_ms for one in _asked(kit, began + len(kinds))]
    soon = [gap for gap in gaps if gap < _SURELY_MS]
    expect(not soon, f"logs were asked for {soon} ms behind a command, expected nothing for {_WAY_MS}")
    whole = await transfer.whole(await transfer.newest(_LOG_S))
    expect(whole == data, f"log {number}: {len(whole)} bytes, other than the autopilot's {len(data)}")
    requests = kit.autopilot.of_type(mark, "LOG_REQUEST_DATA")
    longest = max(one.message.count for one in requests)
    expect(longest <= _MOST_COUNT, f"{longest} bytes asked for at a time, expected {_MOST_COUNT} at most")
    most = max(_in_a_second(requests, one.at_ms) for one in requests)
    expect(most <= _MOST_BYTES_S + _MOST_COUNT, f"{most} bytes asked for in a second")
    return f"disarm in between: {words}; {len(whole)} bytes as the autopilot's, {most} in a second at the most"


def _in_a_second(requests: list[Written], from_ms: int) -> int:
    """The bytes that were asked for in the second from `from_ms` on."""
    return sum(one.message.count for one in requests if 0 <= one.at_ms - from_ms < 1000)
