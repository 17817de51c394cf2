"""A campaign on many machines: Dask hands its series to workers, which push them into the results folder here."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from uuid import uuid4

from distributed import Client, Future, KilledWorker, Scheduler, Security, Worker, wait
from rich.console import Console

from ...errors import Interrupted, SchedulerEnded, UserError
from ...plan.experiments import Plan
from ..resume import next_number
from .estimate import in_words
from .pushing import ArrivedSeries, Store
from .run import Job, SeriesSteps, fly_job, job_of, name_of, said_first, said_given_up, seconds_of
from .worker import SERIES_AT_ONCE, TOPIC, carry_out, end_flights, in_a_process, no_pages, terms

RETRIES = 2
"""How often a series is flown again on another machine after its worker died or something failed there."""
_LOOK_S = 2.0
_ENDED = "the scheduler has ended; what has arrived is kept"


def fly_on_machines(
    plans: Sequence[Plan], root: Path, console: Console, steps: SeriesSteps, address: str, security: Security
) -> bool:
    """As `fly_all`, on all workers of a scheduler; returns whether all numbers of all plans are counted.

    Each series is flown completely on one machine; a partial series in this folder is begun anew. Raises SchedulerEnded
    if the scheduler ends.
    """
    jobs = [job_of(plan, root) for plan in plans]
    left = [job for job in jobs if not job.done]
    console.print(said_first(jobs, len(jobs) - len(left), root), soft_wrap=True, markup=False)
    troubles = [said for job in jobs if job.done for said in said_given_up(job.plan, job.begun)]
    for job in [job for job in left if job.series is not None and next_number(job.begun, job.plan) is None]:
        troubles += fly_job(job, root, lambda *_: [], lambda path: in_a_process(steps.report, path))[1]
        left.remove(job)  # it was flown but not measured yet
    if left:
        root.mkdir(parents=True, exist_ok=True)
        with _campaign(address, security, root) as (client, store):
            troubles += _Flights(client, store, console, root, steps, address).all_of(left, len(jobs))
    for said in troubles:
        console.print(f"not counted: {said}", soft_wrap=True, markup=False)
    return not troubles


async def schedule(port: int, security: Security, said: Callable[[str], object]) -> None:
    """Run Dask's scheduler until this task is cancelled. Raises UserError if it cannot listen on `port`."""
    with no_pages():
        scheduler = Scheduler(
            host="0.0.0.0",
            port=port,
            protocol="tls",
            security=security,
            dashboard=False,
            dashboard_address="127.0.0.1:0",
            allowed_failures=RETRIES,
        )
        try:
            await scheduler
        except (OSError, RuntimeError) as error:
            raise UserError(f"PORT={port}: {error.__cause__ or error}") from error
    said(f"scheduler: {scheduler.address}")
    try:
        await scheduler.finished()
    finally:
        await scheduler.close()


@contextmanager
def _campaign(address: str, security: Security, root: Path) -> Iterator[tuple[Client, Any]]:
    """A client, and the store that workers push to. An early end also ends the flights that are under way."""
    with Client(address, security=security) as client:
        keeper = client.sync(_keeper, address, security)
        try:
            words: dict[str, Any] = {"actor": True, "workers": [keeper.address], "key": f"store-{uuid4().hex}"}
            store = client.submit(Store, root, **words).result()
            yield client, store
        finally:
            client.sync(keeper.close)


async def _keeper(address: str, security: Security) -> Worker:
    """The worker on this machine. It holds the store that workers push to, and flies no series."""
    with no_pages():
        worker = Worker(
            address,
            name=f"results-{uuid4().hex[:8]}",
            security=security,
            nthreads=1,
            memory_limit=0,
            dashboard_address="127.0.0.1:0",
        )
        await worker
    return worker


class _Flights:
    """The series under way. No more are handed out than machines take at once: Dask counts a machine's death against
    every series that waits there.
    """

    def __init__(
        self, client: Client, store: Any, console: Console, root: Path, steps: SeriesSteps, address: str
    ) -> None:
        self._client, self._store, self._console, self._root, self._steps = client, store, console, root, steps
        self._terms = terms()
        self._address = address
        self._known: dict[str, str] | None = None
        self._flying: dict[Future[Any], Job] = {}

    def all_of(self, left: Sequence[Job], of: int) -> list[str]:
        """Fly series in order, as machines become free; returns a line per series or number that does not count."""
        self._client.subscribe_topic(TOPIC, lambda event: self._say(event[1]))
        waiting, troubles = list(left), list[str]()
        try:
            while waiting or self._flying:
                for job in waiting[: max(0, self._machines() * SERIES_AT_ONCE - len(self._flying))]:
                    waiting.remove(job)
                    self._flying[self._submit(job)] = job
                for future in self._done():
                    job = self._flying.pop(future)
                    lacking = [*waiting, *self._flying.values()]
                    troubles += self._ended(future, job, f"{of - len(lacking)} of {of}", lacking)
        except Interrupted:
            self._client.cancel(list(self._flying))
            self._client.run(end_flights)
            raise
        except (OSError, CancelledError) as error:
            raise SchedulerEnded(_ENDED) from error
        return troubles

    def _submit(self, job: Job) -> Future[Any]:
        name = name_of(job.plan)
        return self._client.submit(
            carry_out,
            *(job.plan, name, self._store, self._steps),
            key=f"{name}-{uuid4().hex}",
            resources={self._terms: 1},
            retries=RETRIES,
            pure=False,
        )

    def _done(self) -> set[Future[Any]]:
        if not self._flying:
            time.sleep(_LOOK_S)
            return set()
        try:
            return set(wait(list(self._flying), timeout=_LOOK_S, return_when="FIRST_COMPLETED").done)
        except TimeoutError:
            return set()

    def _ended(self, future: Future[Any], job: Job, place: str, lacking: Sequence[Job]) -> list[str]:
        """Report an ended series; returns lines if it does not count, or not in all its numbers."""
        try:
            found = future.result()
        except KilledWorker:
            said = f"{name_of(job.plan)}: {RETRIES + 1} workers ended while they flew it"
        except CancelledError:
            raise
        except Exception as error:  # noqa: BLE001 - an error on a machine ends only its series
            said = f"{name_of(job.plan)}: {error}"
        else:
            if isinstance(found, ArrivedSeries):
                where = f"{found.files} files, {found.size / 1e6:.1f} MB, in {self._root / found.series}"
                self._say(f"{found.machine}: {name_of(job.plan)}: {place} done: {where}{self._left(lacking)}")
                return list(found.troubles)
            said = found
        self._say(said)
        return [said]

    def _left(self, lacking: Sequence[Job]) -> str:
        if not lacking:
            return ""
        return f"; {in_words(seconds_of(lacking, self._root) / max(1, self._machines()))} left"

    def _machines(self) -> int:
        """Count the workers that fly for this campaign; prints which came, left, or cannot fly for it."""
        if self._client.status != "running":
            raise ConnectionError(_ENDED)
        workers = self._client.scheduler_info()["workers"].values()
        now = {str(one["name"]): offer for one in workers for offer in one["resources"] if offer.startswith("series ")}
        first, before, self._known = self._known is None, self._known or {}, now
        for name in before.keys() - now.keys():
            self._say(f"{name}: gone; what it did not push is flown elsewhere")
        for name in now.keys() - before.keys():
            fits = now[name] == self._terms
            self._say(f"{name}: here" if fits else f"{name}: flies nothing: {now[name]}; expected {self._terms}")
        if not now and (before or first):
            self._say(f"no machine is here; type on each: make worker SCHEDULER={self._address}")
        return sum(offer == self._terms for offer in now.values())

    def _say(self, line: str) -> None:
        self._console.print(line, soft_wrap=True, markup=False)
