"""The commands of a campaign on many machines: its certificate, its scheduler, and its workers.

Dask is imported inside each command, because a campaign on one machine does not need it.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import signal
from collections.abc import Coroutine
from pathlib import Path
from typing import Annotated, Any

import typer

from ..errors import DockerError, UserError
from ..fly.campaign.run import SeriesSteps
from ..fly.campaign.targets import CERTIFICATE, PORT
from ..fly.containers import connect_docker
from ..fly.manifest import machine_name
from ..fly.only_run import only_run
from ..fly.progress import ConsoleProgress
from ..fly.results import Series
from ..fly.runner import Begun, run_series, signals_interrupt
from ..fly.validity import Verdict
from ..plan.experiments import Plan
from ..plan.machines import MAX_PORT, refuse_machines
from ..plan.typed import whole_number
from ..present.reporting import RESULTS, make_console, report_series

LEAST_URGENT = 19
CERTIFICATE_HELP = "The campaign's certificate, of `make certificate`."


def certificate(
    path: Annotated[Path, typer.Argument(help="The new file.")] = Path(CERTIFICATE),
) -> None:
    """Make the certificate of a campaign on many machines: the same file goes to each of them."""
    from ..fly.campaign.certificate import make_certificate

    make_certificate(path)
    typer.echo(f"{path}: bring it to every machine of the campaign; whoever has it can run programs there")


def scheduler(
    port: Annotated[int, typer.Option(help="Where it listens, on all addresses.")] = PORT,
    certificate: Annotated[Path, typer.Option(help=CERTIFICATE_HELP)] = Path(CERTIFICATE),
) -> None:
    """Run Dask's scheduler for a campaign on many machines, until Ctrl-C."""
    from ..fly.campaign.certificate import security_of
    from ..fly.campaign.machines import schedule

    whole_number("PORT", str(port), MAX_PORT)
    quiet()
    asyncio.run(until_a_signal(schedule(port, security_of(certificate), typer.echo)))


def worker(
    scheduler: Annotated[str, typer.Option(help="Its address, as it prints it: tls://HOST:PORT.")],
    certificate: Annotated[Path, typer.Option(help=CERTIFICATE_HELP)] = Path(CERTIFICATE),
    results: Annotated[Path, typer.Option(help="Where series are until they are pushed.")] = RESULTS / ".worker",
) -> None:
    """Fly for campaigns on many machines: one flight at a time, as a scheduler hands them out."""
    from ..fly.campaign.certificate import check_scheduler, security_of
    from ..fly.campaign.worker import work

    refuse_machines(os.environ, "testbed worker")
    quiet()
    security = security_of(certificate)
    check_scheduler(scheduler, security)
    try:
        connect_docker()
    except DockerError as error:
        raise UserError(f"this machine cannot fly: {error}") from error
    name = machine_name()
    asyncio.run(work(scheduler, security, name, results.absolute() / name, typer.echo))


def fly_series(plan: Plan, series: Series, begun: dict[int, Begun]) -> list[Verdict]:
    """Fly the rest of a plan's series, once no other run is in progress on this machine."""
    with signals_interrupt("what was flown is kept"):
        only_run(wait=True)
    return run_series(plan, series, ConsoleProgress(make_console()), begun=begun)


def report_beside_flights(path: Path) -> None:
    """Measure a series and write its report, at low priority beside the flight of the next series."""
    os.nice(LEAST_URGENT)
    report_series(path, make_console())


STEPS = SeriesSteps(fly_series, report_beside_flights)


async def until_a_signal(running: Coroutine[Any, Any, None]) -> None:
    """Run until it ends, or until SIGTERM or Ctrl-C."""
    task = asyncio.ensure_future(running)
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, task.cancel)
    with contextlib.suppress(asyncio.CancelledError):
        await task


def quiet() -> None:
    """Keep Dask's log off the terminal; the testbed prints its own lines instead."""
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
