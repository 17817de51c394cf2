"""Rules of a UAV client, judged by all words, states, beacons and heartbeats that the kit has received."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise

from mqttxt.core.clock import STAMP_MODULUS, STAMP_TICK_MS

from . import shapes
from .autopilot import GCS
from .fields import FIRST_WORDS
from .registry import NotTested, expect, rule
from .tap import Heard
from .uav_kit import UavKit
from .uav_knowledge import UNKNOWN

_STAMPS_MS = STAMP_MODULUS * STAMP_TICK_MS
_HEARTBEAT_MS = 30_000
_BEACONS_MS = 10_000
_GRACE_MS = 1_500
_DEFINITE_NOS = ("denied", "unsupported", "expired", "overtaken", "unreachable")


def _states(kit: UavKit) -> list[tuple[Heard, int | None, str]]:
    below = f"{kit.topics.root}drone{kit.drone}/state/"
    return [(heard, latest_ms, heard.topic.removeprefix(below)) for heard, latest_ms in kit.states]


@rule("uav", "R3.2", "R3.6")
async def states_are_as_specified(kit: UavKit) -> str:
    """Every state has its fields, in range, and a stamp of the session's clock."""
    found = Counter[str]()
    for heard, latest_ms, name in _states(kit):
        if "/" in name:
            continue
        state = shapes.read_state(name, heard.payload, relayed=False)
        found[name] += 1
        if latest_ms is not None:
            ahead_ms = (state["stamp"] * STAMP_TICK_MS - latest_ms) % _STAMPS_MS
            is_ahead = 2 * STAMP_TICK_MS < ahead_ms < _STAMPS_MS // 2
            expect(not is_ahead, f"{name} {shapes.shown(heard.payload)}: stamped {ahead_ms} ms ahead of its clock")
    bundles = kit.tap.since(0, kit.topics.states(kit.drone))
    for heard in bundles:
        shapes.unbundled(heard.payload)
    expect(found, "no state on droneY/state/+ or droneY/states")
    counts = ", ".join(f"{name} {count}" for name, count in sorted(found.items()))
    return f"{counts}; {len(bundles)} bundles"


@rule("uav", "R3.5")
async def states_are_repeated(kit: UavKit) -> str:
    """Each state is published at least every 30 s, changed or not."""
    born_ms, now_ms = kit.births[-1].at_ms, kit.clock.now_ms()
    watched_s = (now_ms - born_ms) / 1000
    if now_ms - born_ms < _HEARTBEAT_MS + _GRACE_MS:
        raise NotTested(f"only {watched_s:.0f} s were watched; needs more than 30 s since its birth")
    times: dict[str, list[int]] = {}
    for heard, _, name in _states(kit):
        times.setdefault(name, []).append(heard.at_ms)
    times.pop(UNKNOWN, None)  # the kit has withheld it
    for name, at_ms in times.items():
        gaps = [later - earlier for earlier, later in zip(at_ms, [*at_ms[1:], now_ms], strict=True)]
        expect(max(gaps) <= _HEARTBEAT_MS + _GRACE_MS, f"{name} was not heard for {max(gaps) / 1000:.1f} s")
    return f"{len(times)} states over {watched_s:.0f} s"


@rule("uav", "R4.2")
async def beacons_are_repeated(kit: UavKit) -> str:
    """A beacon comes at least every 10 s."""
    watched_s = (kit.clock.now_ms() - kit.births[-1].at_ms) / 1000
    times = [at_ms for at_ms, beacon in kit.beacons if beacon["session"] == kit.session]
    times.append(kit.clock.now_ms())
    longest_ms = max(later - earlier for earlier, later in pairwise(times))
    if watched_s * 1000 < _BEACONS_MS + _GRACE_MS:
        raise NotTested(f"only {watched_s:.0f} s were watched; needs more than 10 s since its birth")
    expect(longest_ms <= _BEACONS_MS + _GRACE_MS, f"no beacon for {longest_ms / 1000:.1f} s")
    return f"{len(times) - 1} beacons in {watched_s:.0f} s, at most {longest_ms / 1000:.1f} s apart"


@rule("uav", "R4.1")
async def its_clock_runs_evenly(kit: UavKit) -> str:
    """The session's clock counts milliseconds: within 0.1 % of another clock, and never back."""
    told = [(at_ms, beacon) for at_ms, beacon in kit.beacons if beacon["session"] == kit.session]
    for (_, earlier), (_, later) in pairwise(told):
        text = f"beacons of {earlier['now_ms']} and then {later['now_ms']} ms"
        expect(later["now_ms"] >= earlier["now_ms"], text)
    span_ms, counted_ms = told[-1][0] - told[0][0], told[-1][1]["now_ms"] - told[0][1]["now_ms"]
    if span_ms < _BEACONS_MS:
        raise NotTested(f"only {span_ms / 1000:.0f} s between the first beacon and the last")
    error_ms = abs(counted_ms - span_ms)
    expect(error_ms <= 0.002 * span_ms + 250, f"counted {counted_ms} ms while {span_ms} ms passed")
    return f"counted {counted_ms} ms while {span_ms} ms passed"


@rule("uav", "R5.9")
async def says_one_last_word(kit: UavKit) -> str:
    """Every id has one last word, first words only before it, and no definite no behind a first word."""
    below = f"{kit.topics.root}drone{kit.drone}/commands_result/"
    said: dict[tuple[int, int], list[str]] = {}
    for heard in kit.tap.since(0, below=below):
        word = shapes.read("result", heard.payload)
        if word.get("reason") == "id_conflict":
            continue
        words = said.setdefault((word["gs_session"], word["seq"]), [])
        if words[-1:] != [word["word"]]:
            words.append(word["word"])
    for (gs_session, seq), words in said.items():
        last = [word for word in words if word not in FIRST_WORDS]
        expect(len(last) <= 1, f"of {gs_session}:{seq} came {', '.join(words)}")
        expect(not last or words[-1] == last[0], f"of {gs_session}:{seq} came {', '.join(words)}")
        is_begun = words[0] in FIRST_WORDS
        expect(not is_begun or words[-1] not in _DEFINITE_NOS, f"of {gs_session}:{seq} came {', '.join(words)}")
    return f"{len(said)} ids, none with two last words"


@rule("uav", "R6.12")
async def its_heartbeats_are_a_companion_computers(kit: UavKit) -> str:
    """It sends HEARTBEAT as an onboard controller in system Y, and as a ground station in no other system's name."""
    beats = kit.autopilot.of_type(0, "HEARTBEAT")
    own = [one for one in beats if one.message.get_srcSystem() == kit.drone and one.message.type == 18]
    expect(own, f"no HEARTBEAT of type ONBOARD_CONTROLLER in system {kit.drone} among {len(beats)}")
    strange = [one for one in beats if one.message.type == GCS and one.message.get_srcSystem() == kit.drone]
    expect(not strange, f"{len(strange)} HEARTBEATs of a ground station in system {kit.drone}")
    return f"{len(own)} as ONBOARD_CONTROLLER, {len(beats) - len(own)} others"
