"""An interrupted series: which attempts count, which were cut off, and whether they were flown as they would be now."""

from __future__ import annotations

import json
from collections.abc import Iterator
from itertools import groupby
from typing import Any

from ..errors import ResultsError
from ..plan.experiments import Plan
from ..plan.overrides import fleet_in
from ..plan.profiles.run_plan import run_plan
from ..plan.sensors import gates_of
from .flights import settings_of
from .links import plan_links
from .manifest import configuration_of, machine_name, revision
from .results import LINKS, LINKS_PLAN, METRICS, Attempt, Series, read_json, write_json
from .runner import MOST_REPEATS, Begun, write_paired
from .validity import CUT_OFF, NOT_ENDED, VOID, Verdict, as_measured, written

_LAST_REPEAT = 9
"""A repeat's folder has one digit."""


def begun_of(series: Series, plan: Plan) -> dict[int, Begun]:
    """The state of each number of a plan; numbers without an attempt are left out.

    An attempt that was cut off does not count, nor does it use up one of the number's repeats. The other side's attempt
    of the same repeat is flown again with it.
    """
    made_void = _made_void(series)
    found = {}
    for number in range(1, plan.attempts + 1):
        left, at, flown = MOST_REPEATS + 1, 0, dict[Attempt, Verdict]()
        for repeat, attempts in _repeats(series, plan, number):
            endings = {attempt: _ending(attempt, made_void) for attempt in attempts}
            flown = {attempt: ended for attempt, ended in endings.items() if ended is not None}
            at = repeat
            if _was_cut(endings):
                flown, at = {}, repeat + 1
            elif any(verdict.is_void for verdict in flown.values()):
                left -= 1
                at = repeat + 1
        left = min(left, _LAST_REPEAT + 1 - at)
        if flown or at:
            void = any(verdict.is_void for verdict in flown.values())
            found[number] = Begun(at, flown if left == 0 or not void else {}, left)
    return found


def next_number(begun: dict[int, Begun], plan: Plan) -> int | None:
    """The first number of a plan that has attempts left to fly; None if there is none."""
    numbers = range(1, plan.attempts + 1)
    return next((number for number in numbers if not _is_whole(begun.get(number, Begun()), plan)), None)


def given_up(begun: dict[int, Begun]) -> dict[int, str]:
    """The numbers that have used up their repeats, with the reason why the last attempt was void."""
    return {
        number: next((str(verdict.reason) for verdict in one.flown.values() if verdict.is_void), CUT_OFF)
        for number, one in begun.items()
        if one.left == 0
    }


def to_fly(begun: dict[int, Begun], plan: Plan) -> dict[str, int]:
    """How many attempts are left over each protocol, if none of them will be void."""
    counts = dict.fromkeys(plan.protocols, 0)
    for number in range(1, plan.attempts + 1):
        one = begun.get(number, Begun())
        for protocol in plan.protocols if one.left else ():
            counts[protocol] += all(attempt.protocol != protocol for attempt in one.flown)
    return counts


def amount_of(plan: Plan) -> str:
    """COUNT or SAMPLES, by which measurements of an experiment differ; empty if it has neither."""
    return str(plan.count) if plan.is_message_set else str(plan.samples) if plan.has_sensors else ""


def amount_in(configuration: dict[str, Any]) -> str:
    """As `amount_of`, from a manifest's configuration."""
    return str(configuration.get("count", configuration.get("SAMPLES", "")))


def has_amount(series: Series, plan: Plan) -> bool:
    """Whether a series measures as many messages or samples as a plan; True if none of its manifests can be read."""
    for attempt in series.attempts():
        try:
            return amount_in(attempt.manifest()["configuration"]) == amount_of(plan)
        except ResultsError:  # cut off before its manifest was complete
            continue
    return True


def has_fleet(series: Series, plan: Plan) -> bool:
    """Whether all of a series was flown by a plan's fleet: the file that FLEET names may have changed since.

    Raises UserError as `read_fleet` if an attempt's copy cannot be read.
    """
    return all(fleet_in(attempt.path) == plan.fleet for attempt in series.attempts())


def otherwise(series: Series, plan: Plan) -> str | None:
    """Why attempts flown now would not belong to a series; None if they would.

    Only a revision without changes is known to be the same as that of the series.
    """
    now = revision()
    if now["commit"] is None or now["dirty"]:
        return "what is here now is in no revision"
    configurations = {protocol: configuration_of(plan, settings_of(plan, protocol)) for protocol in plan.protocols}
    for attempt in series.attempts():
        try:
            manifest = attempt.manifest()
        except ResultsError:  # it was cut off before its manifest was complete
            continue
        if manifest["revision"] != now:
            return "it was flown at another revision"
        if manifest["host"].get("name", machine_name()) != machine_name():
            return "it was flown on another machine"
        if manifest["configuration"] != configurations.get(attempt.protocol, manifest["configuration"]):
            return "it was configured otherwise"
        if manifest.get("seeds", {}).get("order") != plan.order_seed:
            return "who flies first was drawn from another seed"
        if not _same_links(attempt, plan):
            return "its links were planned otherwise"
    return None


def settle(series: Series, plan: Plan) -> None:
    """Mark as void, in their manifests, the attempts that were cut off and the counterparts of void attempts.

    Otherwise a number that is flown again would count twice.
    """
    made_void = _made_void(series)
    for number in range(1, plan.attempts + 1):
        for _, attempts in _repeats(series, plan, number):
            endings = {attempt: _ending(attempt, made_void) for attempt in attempts}
            for attempt, ended in endings.items():
                if ended is None:
                    _mark_cut(attempt)
            write_paired({attempt: ended or NOT_ENDED for attempt, ended in endings.items()})


def _mark_cut(attempt: Attempt) -> None:
    """Mark a cut-off attempt as void, unless its manifest says so; one that cannot be read is void as it is."""
    try:
        found = attempt.manifest()
    except ResultsError:
        return
    if found["status"] != VOID:
        write_json(attempt.path / "manifest.json", found | NOT_ENDED.to_data())


def is_measured(series: Series) -> bool:
    """Whether `metrics.json` has every attempt."""
    try:
        sides = read_json(series.path / METRICS)["protocols"]
    except (ResultsError, KeyError):
        return False
    told = {
        (protocol, one["attempt"], one.get("repeat", 0))
        for protocol, side in sides.items()
        for one in (*side["attempts"], *side["void"])
    }
    return told == {(attempt.protocol, attempt.number, attempt.repeat) for attempt in series.attempts()}


def _is_whole(one: Begun, plan: Plan) -> bool:
    return one.left == 0 or {attempt.protocol for attempt in one.flown} >= set(plan.protocols)


def _repeats(series: Series, plan: Plan, number: int) -> Iterator[tuple[int, list[Attempt]]]:
    own = [one for one in series.attempts() if one.number == number and one.protocol in plan.protocols]
    for repeat, attempts in groupby(sorted(own, key=lambda one: one.repeat), key=lambda one: one.repeat):
        yield repeat, list(attempts)


def _ending(attempt: Attempt, made_void: dict[tuple[str, int, int], Verdict]) -> Verdict | None:
    """How an attempt ended; None if it was cut off, or if its manifest cannot be read."""
    try:
        verdict = written(attempt.manifest())
    except ResultsError:
        return None
    if verdict.was_cut:
        return None
    return made_void.get((attempt.protocol, attempt.number, attempt.repeat), verdict)


def _was_cut(endings: dict[Attempt, Verdict | None]) -> bool:
    return any(ended is None for ended in endings.values())


def _made_void(series: Series) -> dict[tuple[str, int, int], Verdict]:
    """The attempts that were found void when they were measured, by protocol, number and repeat.

    A series may have been reported while it was flown: what was under way then was void, with its pair.
    """
    try:
        sides: dict[str, Any] = read_json(series.path / METRICS)["protocols"]
    except (ResultsError, KeyError):
        return {}
    found = {
        (protocol, void["attempt"], void.get("repeat", 0)): as_measured(void)
        for protocol, side in sides.items()
        for void in side["void"]
    }
    return {place: verdict for place, verdict in found.items() if not (verdict.was_cut or verdict.is_of_its_pair)}


def _same_links(attempt: Attempt, plan: Plan) -> bool:
    """Whether `net` would now get the same plan of the links."""
    gates = gates_of(plan.fleet) if plan.has_sensors else ()
    now = run_plan(plan_links(plan, attempt.number), plan.topology, shaper=plan.shaper, gates=gates)
    path = attempt.path / LINKS / LINKS_PLAN
    return path.exists() and read_json(path) == json.loads(json.dumps(now))
