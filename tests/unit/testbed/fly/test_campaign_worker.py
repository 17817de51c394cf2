"""What a worker does of a series: what it goes on with, what it says, when it leaves."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from testbed.errors import ContainerDied, DockerError, TestbedError, UserError
from testbed.fly import resume
from testbed.fly.campaign import worker
from testbed.fly.campaign.pushing import ArrivedSeries, Store
from testbed.fly.campaign.run import SeriesSteps, name_of
from testbed.fly.campaign.targets import Wish, plans_of
from testbed.fly.campaign.worker import Home, carry_out, in_a_process, terms
from testbed.fly.results import Series, new_series
from testbed.fly.runner import Begun, run_series
from testbed.fly.validity import Verdict
from testbed.plan.experiments import Plan
from tests.handmade.finished import count_attempts
from tests.handmade.made_up_fleet import HERE, Fleet, Quiet

(PLAN,) = plans_of(Wish(experiments="scenario-3", arms="thesis", profiles="ideal"))
NAME = name_of(PLAN)


pytestmark = pytest.mark.usefixtures("made_up")


@pytest.fixture(autouse=True)
def _named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MACHINE", "lab-1")


class Waited:
    """A store as an actor is: its methods return what `result` waits for."""

    def __init__(self, store: Store) -> None:
        self._store = store

    def __getattr__(self, name: str) -> Callable[..., Any]:
        return lambda *words: SimpleNamespace(result=lambda timeout: getattr(self._store, name)(*words))


class Machine:
    """A worker without Dask: it does each step at once."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.root = folder / "worker"
        self.results = folder / "results"
        self.store = Store(self.results)
        self.flown: list[Series] = []
        self._monkeypatch = monkeypatch

    def carry_out(self, raises: Exception | None = None) -> tuple[ArrivedSeries | str | None, str | None]:
        """What comes of a series, and why the machine leaves."""
        return asyncio.run(self._carry_out(raises))

    async def _carry_out(self, raises: Exception | None) -> tuple[ArrivedSeries | str | None, str | None]:
        home = Home(self.root)
        log = SimpleNamespace(name="lab-1", plugins={"home": home})
        self._monkeypatch.setattr(worker, "get_worker", lambda: log)
        self._monkeypatch.setattr(worker, "_as_task", lambda _, function, **__: function)

        def fly(plan: Plan, series: Series, begun: dict[int, Begun]) -> list[Verdict]:
            self.flown.append(series)
            if raises is not None:
                raise raises
            return run_series(plan, series, Quiet(), Fleet([]), begun)

        found: ArrivedSeries | str | None = None
        with contextlib.suppress(*([type(raises)] if raises is not None else [])):
            found = carry_out(PLAN, NAME, Waited(self.store), SeriesSteps(fly, count_attempts))
        await asyncio.sleep(0)
        return found, home.leaves.result() if home.leaves.done() else None


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Machine:
    return Machine(tmp_path, monkeypatch)


def test_a_series_is_flown_measured_pushed_and_removed_here(machine: Machine) -> None:
    found, leaves = machine.carry_out()
    assert isinstance(found, ArrivedSeries)
    assert (found.machine, leaves) == ("lab-1", None)
    (attempt, *_) = Series(machine.results / found.series).attempts()
    assert attempt.manifest()["host"]["name"] == "lab-1"
    assert not list(machine.root.glob("*/*/*"))


def test_what_has_arrived_is_not_flown_again(machine: Machine) -> None:
    found, _ = machine.carry_out()
    assert machine.carry_out()[0] == found
    assert len(machine.flown) == 1


def test_what_this_machine_has_whole_is_only_pushed(machine: Machine) -> None:
    series = new_series(machine.root, "scenario-3", "thesis", "ideal")
    run_series(PLAN, series, Quiet(), Fleet([]))
    count_attempts(series.path)
    machine.carry_out()
    (arrived,) = machine.results.glob("scenario-3/*/2*")
    assert len(Series(arrived).attempts()) == 2


@pytest.mark.parametrize("now", [{"commit": "decaf", "dirty": False}, {"commit": "c0ffee", "dirty": True}])
def test_what_it_has_of_another_revision_is_left(
    machine: Machine, monkeypatch: pytest.MonkeyPatch, now: dict[str, Any]
) -> None:
    series = new_series(machine.root, "scenario-3", "thesis", "ideal")
    run_series(PLAN, series, Quiet(), Fleet([]))
    monkeypatch.setattr(resume, "revision", lambda: now)
    machine.carry_out()
    assert machine.flown != [series]
    assert series.path.exists()


def test_a_series_that_cannot_be_flown_is_a_line(machine: Machine) -> None:
    said = machine.carry_out(UserError("the mission could not be flown: --streams: none"))
    assert said == (f"{NAME}, on lab-1: the mission could not be flown: --streams: none", None)


@pytest.mark.parametrize(
    ("raised", "leaves"),
    [
        (DockerError("Docker does not answer"), "Docker does not answer"),
        (ContainerDied("net ended"), None),
        (TestbedError("the disk is full"), None),
    ],
)
def test_a_machine_without_docker_leaves_and_the_series_goes_elsewhere(
    machine: Machine, raised: Exception, leaves: str | None
) -> None:
    assert machine.carry_out(raised) == (None, leaves)
    assert machine.store.there(NAME) is None


@pytest.mark.parametrize(
    ("now", "environment", "said"),
    [
        (HERE, {}, "series at c0ffee"),
        ({"commit": "c0ffee" * 6, "dirty": True}, {}, "series at c0ffeec0ffee with changes"),
        ({"commit": None, "dirty": None}, {}, "series at no revision"),
        (HERE, {"AUTOPILOT": "px4"}, "series at c0ffee+autopilot-px4"),
    ],
)
def test_a_series_goes_to_machines_that_would_fly_it_alike(
    monkeypatch: pytest.MonkeyPatch, now: dict[str, Any], environment: dict[str, str], said: str
) -> None:
    monkeypatch.setattr(worker, "revision", lambda: now)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    assert terms() == said


@pytest.mark.long
def test_a_step_runs_in_a_process_of_its_own_whose_errors_come_back() -> None:
    assert in_a_process(os.getpid) != os.getpid()
    with pytest.raises(FileNotFoundError, match="/nowhere"):
        in_a_process(os.listdir, "/nowhere")


@pytest.mark.long
def test_a_step_whose_process_is_killed_is_an_error_of_its_own() -> None:
    with pytest.raises(TestbedError, match="the process of raise_signal was killed"):
        in_a_process(signal.raise_signal, signal.SIGKILL)
