"""A machine that flies for a campaign: a Dask worker, and the tasks by which it flies a series.

A series is one task, so all of it is flown on one machine. Its flights and its reports are tasks of their own: a flight
takes the one FLIGHT resource of the worker, a report only a core, while the next series flies. Each runs in a process
of its own, which ends when the worker does.
"""

from __future__ import annotations

import asyncio
import ctypes
import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any
from uuid import uuid4

import dask
from distributed import Security, Worker, WorkerPlugin, get_client, get_worker

from ...errors import DockerError, FleetError, ResultsError, TestbedError, UserError
from ...plan.experiments import Plan
from ...plan.overrides import suffix
from ..manifest import revision
from ..resume import otherwise
from .pushing import ArrivedSeries, push, remove
from .run import Job, SeriesSteps, fly_job, job_of, name_of

FLIGHT = "flight"
SERIES_AT_ONCE = 2
"""One flies while the other is measured."""
RETIRES_S = 10.0
"""How long a worker that ends waits for the scheduler to hand its series to others."""
TOPIC = "campaign"
_ANSWER_S = 300.0
_PR_SET_PDEATHSIG = 1


class Home(WorkerPlugin):
    """A worker's machine, for the tasks that run on it: the folder `root` has its series until they are pushed."""

    name = "home"

    def __init__(self, root: Path) -> None:
        self.root = root
        self.leaves: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        self._loop = asyncio.get_running_loop()

    def leave(self, reason: str) -> None:
        """End the worker, from any thread."""
        self._loop.call_soon_threadsafe(self._leave, reason)

    def _leave(self, reason: str) -> None:
        if not self.leaves.done():
            self.leaves.set_result(reason)


class Remote:
    """A store on another machine; each of its methods waits for the answer."""

    def __init__(self, actor: Any) -> None:
        self._actor = actor

    def __getattr__(self, name: str) -> Callable[..., Any]:
        def call(*words: Any) -> Any:
            return getattr(self._actor, name)(*words).result(timeout=_ANSWER_S)

        return call


def terms() -> str:
    """The resource that a series needs: the revision and settings that machines must share to fly it alike."""
    now = revision()
    commit = str(now["commit"] or "no revision")[:12]
    return f"series at {commit}{' with changes' if now['dirty'] else ''}{suffix(os.environ)}"


def carry_out(plan: Plan, name: str, actor: Any, steps: SeriesSteps) -> ArrivedSeries | str:
    """Fly, measure and push a plan's series, or return a line that says why it cannot be flown.

    A partial series on this machine is resumed, as on a single machine, if it is of the present revision. Raises
    errors that another machine may not have; the series is then flown again.
    """
    worker, store = get_worker(), Remote(actor)
    home = worker.plugins[Home.name]
    assert isinstance(home, Home)
    there: ArrivedSeries | None = store.there(name)
    if there is not None:
        return there
    fly, report = _as_task(_flight, steps.fly, needs={FLIGHT: 1}), _as_task(in_a_process, steps.report, needs={})
    try:
        series, troubles = fly_job(_job(plan, home.root), home.root, fly, report)
    except (UserError, ResultsError) as error:
        return f"{name_of(plan)}, on {worker.name}: {error}"
    except DockerError as error:
        if not isinstance(error, FleetError):
            home.leave(str(error))
        raise
    arrived = push(series, home.root, name, str(worker.name), troubles, store)
    remove(series, home.root)
    return arrived


def in_a_process(function: Callable[..., Any], *words: Any) -> Any:
    """Call a function in the main thread of a new process, which gets SIGTERM however this process ends."""
    spawn = multiprocessing.get_context("spawn")
    answers, answer = spawn.Pipe(duplex=False)
    process = spawn.Process(target=_call, args=(answer, os.getpid(), function, words))
    process.start()
    answer.close()
    try:
        found = answers.recv()
    except EOFError as error:
        raise TestbedError(f"the process of {function.__name__} was killed") from error
    finally:
        answers.close()
        process.join()
    if isinstance(found, Exception):
        raise found
    return found


async def work(address: str, security: Security, machine: str, root: Path, said: Callable[[str], object]) -> None:
    """Fly for the campaigns of a scheduler until SIGTERM, Ctrl-C, or the scheduler's end.

    Raises UserError if another worker has this machine's name or no scheduler answers, DockerError if this machine can
    no longer fly, TestbedError if the scheduler has ended or given this machine up.
    """
    os.environ["MACHINE"] = machine
    home = Home(root)
    with no_pages():
        worker = Worker(
            address,
            name=machine,
            security=security,
            nthreads=SERIES_AT_ONCE + 1 + (os.cpu_count() or 1),
            resources={terms(): SERIES_AT_ONCE, FLIGHT: 1},
            memory_limit=0,
            dashboard_address="127.0.0.1:0",
            plugins=(home,),
        )
        try:
            await worker
        except (OSError, ValueError, RuntimeError) as error:
            why = str(_innermost(error))
            found = "another worker has this name" if "name taken" in why else why
            raise UserError(f"MACHINE={machine}: {found}; expected a name of its own, and a scheduler") from error
    said(f"{machine} flies for {address}; Ctrl-C ends it")
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, home.leave, "")
    ended = asyncio.ensure_future(worker.finished())
    await asyncio.wait({ended, home.leaves}, return_when=asyncio.FIRST_COMPLETED)
    if not ended.done():  # retiring hands its series to others without counting this end against them
        with suppress(TimeoutError, OSError):
            async with asyncio.timeout(RETIRES_S):
                await worker.scheduler.retire_workers(workers=[worker.address], close_workers=False, remove=True)
    end_flights()
    await worker.close()
    if not home.leaves.done():
        raise TestbedError(f"{address}: the scheduler has ended, or has given {machine} up")
    if home.leaves.result():
        raise DockerError(f"{machine} leaves the campaign: {home.leaves.result()}")


def end_flights() -> None:
    """End the flights and measurements of this process, with their containers, as Ctrl-C does."""
    for process in multiprocessing.active_children():
        process.terminate()


@contextmanager
def no_pages() -> Iterator[None]:
    """Leave Dask's web pages, which are not encrypted, empty."""
    with dask.config.set({f"distributed.{role}.http.routes": [] for role in ("scheduler", "worker")}):
        yield


def _job(plan: Plan, root: Path) -> Job:
    job = job_of(plan, root)
    if job.series is not None and otherwise(job.series, plan) is not None:
        return Job(plan, None, {})
    return job


def _as_task(call: Callable[..., Any], function: Callable[..., Any], needs: dict[str, float]) -> Callable[..., Any]:
    """Make a step a task of its own on this worker, of whose resources it needs `needs`."""

    def step(*words: Any) -> Any:
        here, key = [get_worker().address], f"{function.__name__}-{uuid4().hex}"
        return get_client().submit(call, function, *words, key=key, workers=here, resources=needs).result()

    return step


def _flight(fly: Callable[..., Any], plan: Plan, *words: Any) -> Any:
    worker = get_worker()
    worker.log_event(TOPIC, f"{worker.name} flies {name_of(plan)}")
    return in_a_process(fly, plan, *words)


def _call(answer: Connection, parent: int, function: Callable[..., Any], words: tuple[Any, ...]) -> None:
    """Run in the new process; the kernel sends it SIGTERM when the thread that started it ends, as with its worker."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
    if os.getppid() != parent:
        return
    try:
        found = function(*words)
    except Exception as error:  # noqa: BLE001 - the waiting process raises it
        found = error
    with suppress(BrokenPipeError):
        answer.send(found)


def _innermost(error: BaseException) -> BaseException:
    while error.__cause__ is not None:
        error = error.__cause__
    return error
