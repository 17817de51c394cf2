"""Flies what a campaign lacks, series by series, and reports its progress."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from ...errors import ResultsError, UserError
from ...plan import wording
from ...plan.experiments import Plan
from ...plan.overrides import suffix
from ..results import Series, new_series, series_folder
from ..resume import begun_of, given_up, has_amount, has_fleet, is_measured, next_number, otherwise, settle, to_fly
from ..runner import Begun
from ..validity import Verdict
from .estimate import Durations, in_words

Fly = Callable[[Plan, Series, dict[int, Begun]], list[Verdict]]
"""Flies the rest of a plan's series."""
Report = Callable[[Path], object]
"""Measures a series and writes its report; needs only its folder."""


@dataclass(frozen=True)
class SeriesSteps:
    """The functions that fly and measure a series. They are module-level, so that other processes can call them."""

    fly: Fly
    report: Report


@dataclass(frozen=True)
class Job:
    """A plan, the series to resume (None: a new one), and the attempts that the series has.

    `why_new` is the reason why an interrupted series is not resumed.
    """

    plan: Plan
    series: Series | None
    begun: dict[int, Begun]
    why_new: str | None = None

    @property
    def done(self) -> bool:
        """Whether nothing is left to fly or measure."""
        return self.series is not None and next_number(self.begun, self.plan) is None and is_measured(self.series)


def job_of(plan: Plan, root: Path) -> Job:
    """Look for a plan's series in a results folder: a finished one of any revision, else an interrupted one."""
    folder = series_folder(root, plan.experiment, _label(plan), plan.profile.name)
    found = [Series(path) for path in folder.glob("*") if path.is_dir()]
    alike = [one for one in found if one.attempts() and has_amount(one, plan) and has_fleet(one, plan)]
    newest = sorted(alike, key=lambda one: one.path.name, reverse=True)
    jobs = [Job(plan, series, begun_of(series, plan)) for series in newest]
    whole = next((job for job in jobs if next_number(job.begun, plan) is None), None)
    if whole is not None or not jobs:
        return whole or Job(plan, None, {})
    why_new = otherwise(newest[0], plan)
    return jobs[0] if why_new is None else Job(plan, None, {}, why_new)


def fly_all(plans: Sequence[Plan], root: Path, console: Console, fly: Fly, report: Report) -> bool:
    """Fly every plan that has no finished series; returns whether all numbers of all plans are counted.

    A series that cannot be flown is reported, and the others are flown. Raises only what ends the run: Interrupted,
    DockerError if Docker no longer answers, TestbedError or OSError as of a full disk.
    """
    jobs = [job_of(plan, root) for plan in plans]
    waiting = [job for job in jobs if not job.done]
    done = len(jobs) - len(waiting)
    console.print(said_first(jobs, done, root), soft_wrap=True, markup=False)
    troubles = [said for job in jobs if job.done for said in said_given_up(job.plan, job.begun)]
    for place, job in enumerate(waiting):
        left = in_words(seconds_of(waiting[place:], root))
        console.print(
            f"\nseries {done + place + 1} of {len(jobs)}, {left} left: {name_of(job.plan)}{_how(job)}", markup=False
        )
        try:
            troubles += fly_job(job, root, fly, report)[1]
        except (UserError, ResultsError) as error:
            troubles.append(f"{name_of(job.plan)}: {error}")
            console.print(str(error), soft_wrap=True, markup=False)
    for said in troubles:
        console.print(f"not counted: {said}", soft_wrap=True, markup=False)
    return not troubles


def fly_job(job: Job, root: Path, fly: Fly, report: Report) -> tuple[Series, list[str]]:
    """Fly and measure until every number counts or is given up; returns the series and a line per number given up."""
    plan, begun = job.plan, job.begun
    series = job.series or new_series(root, plan.experiment, _label(plan), plan.profile.name)
    while True:
        settle(series, plan)
        fly(plan, series, begun)
        report(series.path)
        begun = begun_of(series, plan)  # a completed attempt may be void once it is measured
        if next_number(begun, plan) is None:
            return series, said_given_up(plan, begun)


def said_first(jobs: Sequence[Job], done: int, root: Path) -> str:
    """A line on what there is to fly, how much of it is done, and about how long the rest takes."""
    plans = [job.plan for job in jobs]
    kinds = {
        "experiment": {plan.experiment for plan in plans},
        "arm": {plan.arm.name for plan in plans},
        "profile": {plan.profile.name for plan in plans},
    }
    of = ", ".join(wording.plural(len(names), kind) for kind, names in kinds.items())
    attempts = wording.plural(plans[0].attempts, "attempt")
    left = f"; {in_words(seconds_of(jobs, root))} to go" if done < len(jobs) else ""
    return f"{len(jobs)} series ({of}), {attempts} over each protocol: {done} done{left}"


def seconds_of(jobs: Sequence[Job], root: Path) -> float:
    """The seconds that the attempts which jobs lack take on one machine."""
    durations = Durations(root)
    lacking = [(job.plan, to_fly(job.begun, job.plan)) for job in jobs if not job.done]
    return sum(count * durations.of(plan, protocol) for plan, counts in lacking for protocol, count in counts.items())


def _how(job: Job) -> str:
    """The attempt at which a job resumes, or the reason why it begins anew."""
    if job.series is None:
        return f", begun anew ({job.why_new})" if job.why_new else ""
    number = next_number(job.begun, job.plan)
    return ", flown and not measured yet" if number is None else f", goes on with attempt {number}"


def said_given_up(plan: Plan, begun: dict[int, Begun]) -> list[str]:
    """A line for each number that was given up, having been void as often as allowed."""
    return [
        f"{name_of(plan)}, attempt {number}: void each time, at last: {wording.first_line(reason)}"
        for number, reason in given_up(begun).items()
    ]


def _label(plan: Plan) -> str:
    return plan.label + suffix(os.environ)


def name_of(plan: Plan) -> str:
    """A plan's series in words."""
    return f"{wording.short_name(plan.experiment)}, arm {plan.label}, profile {plan.profile.name}"
