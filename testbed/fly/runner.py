"""Flies the attempts of a series: starts the fleet, flies the mission, removes the fleet, and judges the attempt."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Protocol

from net.link_plan import Gate

from ..errors import DockerError, FleetError, Interrupted, LinksOff, ProbesLate, TestbedError, UserError
from ..plan.experiments import Plan
from ..plan.profiles.resolve import LinksPlan
from ..plan.sensors import closed_links, gates_of
from . import links as link_files
from .calibration import calibrate
from .calibration.clocks import ahead_ns, measure_clocks
from .containers import Containers, start_network
from .daemon import Usage
from .flights import mission_command, profile_of, remove_sockets, settings_of
from .identities import make_identities
from .manifest import describe, mosquitto_version
from .observations import Clock, observe
from .page_process import page_beside
from .processors import Others
from .quiet import LEAST_IDLE, LIMIT_S, Waited, wait_for_quiet
from .results import Attempt, Series, new_attempt, point_latest, read_json, write_json
from .validity import INTERRUPTED, Observed, Verdict, cut_off, judge, paired

COMPLETED_CODE, FAILED_CODE, BAD_INPUT = 0, 1, 2
"""Exit codes of the mission's process."""
MOST_REPEATS = 2
"""How often the attempts of a number are flown again after one of them was void."""
SIGNALS = (signal.SIGTERM, signal.SIGINT)


class Progress(Protocol):
    """Shows the progress of a run."""

    def attempt(self, protocol: str, number: int, of: int, repeat: int) -> None: ...
    def phase(self, text: str) -> contextlib.AbstractContextManager[None]: ...
    def step(self, name: str, drones: dict[str, str], at_s: float) -> None: ...
    def ended(self, status: str, reason: str | None) -> None: ...


@dataclass(frozen=True)
class Begun:
    """The state of a number: the repeat at which to go on, and the attempts of that repeat with their verdicts.

    `left` is how many repeats are left, that one included.
    """

    repeat: int = 0
    flown: Mapping[Attempt, Verdict] = field(default_factory=dict)
    left: int = MOST_REPEATS + 1


def run_series(
    plan: Plan,
    series: Series,
    progress: Progress,
    make_containers: Callable[..., Containers] = Containers,
    begun: Mapping[int, Begun] | None = None,
) -> list[Verdict]:
    """Fly every attempt of a plan, over one protocol after the other, in alternating order.

    Both attempts of a number meet the same links, or neither counts: if one is void, the other is too, and both are
    flown again, at most twice, each time after waiting for a quieter moment of the machine. A failed attempt does not
    end the series; a lost Docker does, with DockerError: between flights, or in the last repeat of a number. An attempt
    that the live page shows is not repeated, as it never counts. `begun` is the state of an interrupted series, by
    number. Returns the verdicts of each number's last repeat, in the order of the flights.
    """
    endings: list[Verdict] = []
    with signals_interrupt(f"what was captured is kept in {series.path}"):
        for number in range(1, plan.attempts + 1):
            there = (begun or {}).get(number, Begun())
            flown = dict(there.flown)
            for repeat in range(there.repeat, there.repeat + (there.left if plan.page is None else 1)):
                flown, waited = ({}, _wait(progress)) if repeat > there.repeat else (flown, None)
                for protocol in plan.order(number):
                    if any(attempt.protocol == protocol for attempt in flown):
                        continue
                    progress.attempt(protocol, number, plan.attempts, repeat)
                    attempt = new_attempt(series, protocol, number, repeat)
                    with _disk_errors_named(attempt):
                        flown[attempt] = _fly(plan, attempt, progress, make_containers, waited)
                    progress.ended(flown[attempt].status, flown[attempt].reason)
                    if plan.page is None:
                        point_latest(series)
                    if flown[attempt].is_void and plan.page is None:
                        break
                flown = write_paired(flown)
                if not any(verdict.is_void for verdict in flown.values()):
                    break
            for attempt, verdict in flown.items():
                if verdict.was_cut:
                    raise DockerError(f"{attempt.path}: {verdict.reason}, in the last of its repeats")
            endings += flown.values()
    return endings


def _wait(progress: Progress) -> Waited:
    """Wait for a quieter moment of the machine, at most LIMIT_S, and print so."""
    with progress.phase(f"waiting until {LEAST_IDLE:.0%} of the processors are idle, {LIMIT_S:.0f} s at most"):
        return wait_for_quiet()


@contextlib.contextmanager
def _disk_errors_named(attempt: Attempt) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise TestbedError(
            f"{attempt.path}: {error.strerror or error}; the containers are ended, what was written is kept"
        ) from error


def write_paired(flown: Mapping[Attempt, Verdict]) -> dict[Attempt, Verdict]:
    """Pair the verdicts of a number's attempts (`paired`), and write those that change into the manifests."""
    found = paired(flown)
    for attempt, verdict in found.items():
        if verdict != flown[attempt]:
            path = attempt.path / "manifest.json"
            write_json(path, read_json(path) | verdict.to_data())
    return found


def _fly(
    plan: Plan,
    attempt: Attempt,
    progress: Progress,
    make_containers: Callable[..., Containers],
    waited: Waited | None,
) -> Verdict:
    settings = settings_of(plan, attempt.protocol)
    if plan.mission is not None:
        shutil.copyfile(plan.mission, attempt.path / plan.mission.name)
    gates = gates_of(plan.fleet) if plan.has_sensors else ()
    links = link_files.plan_links(plan, attempt.number)
    folder = attempt.path / "links"
    link_files.write_plan(folder, links, plan.topology, plan.shaper, gates=gates)
    manifest = describe(plan, attempt, settings, links)
    if waited is not None:
        manifest["host"] |= {"waited_s": waited.seconds, "idle": waited.idle}
    write_json(attempt.path / "manifest.json", manifest)
    failure: str | None = INTERRUPTED
    off_before, begun_s, clock = None, time.monotonic(), Clock()
    try:
        containers = make_containers(profile_of(plan, attempt.protocol), attempt.path, settings, plan.fleet)
        with _fleet_up(plan, containers, attempt, manifest, links, gates, progress), page_beside(plan, attempt):
            command = mission_command(plan, attempt.protocol)
            failure = _mission(command, plan.limit_s, containers, attempt, progress)
    except Interrupted:
        raise
    except (LinksOff, ProbesLate) as error:
        off_before = str(error)
    except FleetError as error:
        failure = str(error)
    except (TestbedError, OSError) as error:
        lost = isinstance(error, DockerError) and attempt.was_flown
        if not lost or failure in (INTERRUPTED, None):  # a mission that had failed before Docker did stays failed
            failure = cut_off(error)
        if not lost:
            raise
    finally:
        manifest["captures"] = attempt.captures()
        seen = (
            Observed(failure, off_before)
            if off_before is not None
            else observe(attempt, manifest, failure, lambda: link_files.off_lines(folder, links))
        )
        seen = replace(seen, watched=plan.page is not None, clock_set=clock.set_s())
        verdict = judge(seen)
        manifest |= {**verdict.to_data(), "observed": asdict(seen), "took_s": round(time.monotonic() - begun_s, 1)}
        manifest["host"]["load_after"] = os.getloadavg()[0]
        write_json(attempt.path / "manifest.json", manifest)
    return verdict


@contextlib.contextmanager
def _fleet_up(
    plan: Plan,
    containers: Containers,
    attempt: Attempt,
    manifest: dict[str, Any],
    links: LinksPlan,
    gates: Sequence[Gate],
    progress: Progress,
) -> Iterator[None]:
    """Run the fleet as long as the context lasts: first the network, the rest once its links are as planned.

    The fleet is removed whatever happens. Raises LinksOff if the links are not as planned.
    """
    others = Others()
    try:
        topology, folder = attempt.topology(), attempt.path / "links"
        nodes = [node.name for node in topology.nodes]
        with progress.phase(f"starting the network and its {len(nodes)} nodes"):
            containers.down()
            start_network(containers, nodes)
        shaper = link_files.read_shaper(folder)
        manifest |= {"shaper": shaper["shaper"], "shaping": shaper}
        with progress.phase("calibrating the links"):
            clocks = measure_clocks(plan.fleet, plan.machines, containers.output)
            manifest |= {"machines": [clock.to_data() for clock in clocks]} if clocks else {}
            calibration = calibrate(links, topology, containers.output, closed_links(gates), ahead_ns(clocks))
        manifest["calibration"] = link_files.write_calibration(folder, calibration)
        if off := (*(clock.off for clock in clocks if clock.off is not None), *calibration.off):
            raise LinksOff("; ".join(off))
        if plan.is_secured(attempt.protocol):
            with progress.phase("making the fleet's identities"):
                make_identities(containers, plan)
        with progress.phase(f"starting {containers.count - len(nodes) - 1} containers on them"):
            containers.start()
        manifest["images"] = containers.images()
        manifest["versions"] |= containers.versions()
        if attempt.protocol == "mqttxt":
            manifest["versions"]["mosquitto"] = mosquitto_version(containers.output("broker", ["mosquitto", "-h"]))
        manifest["versions"]["tc"] = containers.output("net", ["tc", "-V"]).strip()
        yield
    finally:
        with signals_wait(), progress.phase("ending the containers"):
            used = _take_down(containers, attempt)
            manifest["cpu_s"] = {service: each.cpu_s for service, each in used.items()}
            if not plan.machines:
                manifest["host"]["others"] = others.share(sum(manifest["cpu_s"].values()))
            memory = {service: each.memory_bytes for service, each in used.items()}
            manifest["memory_bytes"] = {service: count for service, count in memory.items() if count is not None}


def _mission(
    command: list[str], limit_s: float, containers: Containers, attempt: Attempt, progress: Progress
) -> str | None:
    """Fly the mission, its output but progress in logs/mission.log. Returns why it was not completed, or None."""
    lines = containers.execute("gs", command, limit_s=limit_s)
    said = last = ""
    with (attempt.path / "logs" / "mission.log").open("w", encoding="utf-8") as log:
        while True:
            try:
                line = next(lines)
            except StopIteration as stop:
                code = stop.value
                break
            shown = _progress_line(line)
            if shown is not None:
                progress.step(shown["step"], shown["drones"], shown["at_s"])
                continue
            log.write(f"{line}\n")
            last = line.strip() or last
            if line.startswith("mission: "):
                said = line.removeprefix("mission: ")
    if code == BAD_INPUT:
        raise UserError(f"the mission could not be flown: {said or last}")
    if code == COMPLETED_CODE:
        return None
    if code == FAILED_CODE and said:
        return said
    return f"the mission's process ended with exit code {code}" + (f": {said or last}" if last else "")


def _progress_line(line: str) -> dict[str, Any] | None:
    try:
        found = json.loads(line)
    except ValueError:
        return None
    return found if isinstance(found, dict) and {"step", "drones", "at_s"} <= set(found) else None


def _take_down(containers: Containers, attempt: Attempt) -> dict[str, Usage]:
    """End the network first, so that its captures are complete; then save the logs, then remove all containers.

    Each step is done even if another fails (a full disk, a container that is gone). Returns each service's usage.
    """
    with contextlib.ExitStack() as last_first:
        last_first.callback(remove_sockets, attempt.path)
        last_first.callback(containers.down)
        last_first.callback(containers.save_logs, attempt.path / "logs")
        last_first.callback(containers.stop, "net")
        return containers.usage()


@contextlib.contextmanager
def signals_wait() -> Iterator[None]:
    """Defer signals to the end of the context: removing the containers is short, and must be complete."""
    heard: list[int] = []
    before = {number: signal.signal(number, lambda number, _: heard.append(number)) for number in SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if heard:
            signal.raise_signal(signal.Signals(heard[0]))


@contextlib.contextmanager
def signals_interrupt(kept: str) -> Iterator[None]:
    """Let SIGTERM and Ctrl-C end a run with Interrupted; `kept` says in its message which results are kept."""

    def interrupt(*_: object) -> None:
        for number in before:
            signal.signal(number, signal.SIG_IGN)  # once is enough
        raise Interrupted(f"interrupted; the containers are ended, {kept}")

    before = {number: signal.getsignal(number) for number in SIGNALS}
    for number in before:
        signal.signal(number, interrupt)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
