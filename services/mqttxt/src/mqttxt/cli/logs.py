"""`mqttxt gs logs`: downloads the flight logs of a drone's autopilot."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import ConfigurationError, TransferFailed
from .station import Job, with_a_drone

if TYPE_CHECKING:
    from ..protocol.logs import FlightLog
    from ..station.log_download import LogProgress
    from ..station.views import Drone

logs_app = typer.Typer(help="The flight logs of a drone's autopilot.", no_args_is_help=True, rich_markup_mode=None)

TOLD_EVERY_S = 5.0
LEAST_KIB_S, MOST_KIB_S, LARGEST_KIB_S = 1, 128, 1_000_000
"""The range of `--most-kib-s`, with its default between them."""


@logs_app.command("list")
@with_a_drone
def list_() -> Job:
    """Print the logs that a drone's autopilot has now: number, bytes and time (UTC, by the autopilot's clock)."""

    async def job(there: Drone) -> int:
        for log in await _logs_of(there):
            typer.echo(f"{log.number:>5} {log.size:>11} {_time_of(log)}")
        return 0

    return job


@logs_app.command()
@with_a_drone
def get(
    number: Annotated[int, typer.Argument(help="The log's number in the list.")],
    file: Annotated[Path, typer.Argument(help="The file to write: ULog of a PX4, DataFlash of an ArduPilot.")],
    most_kib_s: Annotated[int, typer.Option(help="KiB that are carried in a second at most.")] = MOST_KIB_S,
) -> Job:
    """Write a log into a file, and say how far it is; what broke off goes on where it was."""
    from ..security.files import named_by_user

    if not LEAST_KIB_S <= most_kib_s <= LARGEST_KIB_S:
        raise ConfigurationError(f"--most-kib-s {most_kib_s}: expected {LEAST_KIB_S} to {LARGEST_KIB_S}")
    named_by_user(file)

    async def job(there: Drone) -> int:
        found = {log.number: log for log in await _logs_of(there)}
        if number not in found:
            numbers = ", ".join(map(str, found)) or "none"
            raise ConfigurationError(f"log {number}: drone {there.number} has no such log; its logs: {numbers}")
        log = found[number]
        with _disarmed_advised():
            await there.download_log(log, file, most_bytes_s=1024 * most_kib_s, progress=_Told())
        typer.echo(f"{file}: {log.size} bytes")
        return 0

    return job


async def _logs_of(there: Drone) -> tuple[FlightLog, ...]:
    with _disarmed_advised():
        return await there.logs()


@contextlib.contextmanager
def _disarmed_advised() -> Iterator[None]:
    """Say in the error about an armed drone what it has to be."""
    try:
        yield
    except TransferFailed as error:
        if error.reason != "armed":
            raise
        raise TransferFailed(f"{error}; expected a disarmed drone", error.reason) from None


class _Told:
    """Prints the progress on stderr, at most once per TOLD_EVERY_S."""

    def __init__(self) -> None:
        self._next_s = 0.0

    def __call__(self, progress: LogProgress) -> None:
        now_s = time.monotonic()
        if now_s >= self._next_s:
            self._next_s = now_s + TOLD_EVERY_S
            what = "carried, compressed" if progress.is_at_drone else "read from the autopilot"
            typer.echo(f"{progress.done} of {progress.size} bytes {what}", err=True)


def _time_of(log: FlightLog) -> str:
    return f"{datetime.fromtimestamp(log.time_s, UTC):%Y-%m-%d %H:%M:%S}" if log.time_s is not None else "-"
