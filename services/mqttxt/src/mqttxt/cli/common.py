"""What the subcommands share: how errors end a process, logging, and running a role until a signal.

asyncio is imported by what runs: it and ssl are a quarter of a command's start, and help needs neither.
"""

from __future__ import annotations

import contextlib
import gc
import logging
import signal
import sys
from collections.abc import Callable, Coroutine, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..core.printable import printable
from ..core.settings import Settings
from ..errors import ConfigurationError, MqttxtError
from ..protocol.values import Encoding

if TYPE_CHECKING:
    from ..core.runner import Runner

IdentityFolder = Annotated[
    Path | None,
    typer.Option("--identity", help="The folder of this node's identity, for mqtts:// (`mqttxt keys issue`)."),
]
Signed = Annotated[
    bool,
    typer.Option(
        "--signed", help="Sign, and hear only what is signed; takes --identity. The whole fleet, or none of it."
    ),
]
Insecure = Annotated[
    bool, typer.Option("--insecure", help="Allow mqtt:// to other machines: whoever is there commands the drones.")
]


@contextlib.contextmanager
def errors_as_lines() -> Iterator[None]:
    """An error raised on purpose becomes one line on stderr and its exit code."""
    try:
        yield
    except MqttxtError as error:
        typer.echo(printable(f"mqttxt: {error}"), err=True)
        raise typer.Exit(error.exit_code) from None


class _Lines(logging.Formatter):
    """A message is one line, whatever of others' texts is in it."""

    def formatMessage(self, record: logging.LogRecord) -> str:
        record.message = printable(record.message)
        return super().formatMessage(record)


def set_up_logging(verbose: bool) -> None:
    """Log lines go to stderr."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_Lines("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    logging.basicConfig(handlers=[handler], level=logging.DEBUG if verbose else logging.INFO)


def settings(qos: int, json: bool, bundles: bool = False) -> Settings:
    """The settings common to all roles; raises ConfigurationError."""
    if qos not in (0, 1):
        raise ConfigurationError(f"--qos {qos}: expected 0 or 1")
    return Settings(qos=qos, encoding=Encoding.JSON if json else Encoding.CBOR, bundles=bundles)


def run_role(make: Callable[[], Runner]) -> None:
    """Run a role until SIGTERM or SIGINT, which end it cleanly (exit code 0).

    With an identity SIGHUP reads the revocation list anew; without, it ends the process as always.
    """
    import asyncio

    # A message makes many objects that live for microseconds, in no cycles: looking for those less often saves a tenth
    # of an activator's time. What the imports made stays for good.
    gc.freeze()
    gc.set_threshold(50_000, 20, 50)
    with errors_as_lines():
        asyncio.run(_until_signal(make))


async def _until_signal(make: Callable[[], Runner]) -> None:
    import asyncio

    loop = asyncio.get_running_loop()
    runner = make()
    task = asyncio.create_task(runner.run())
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, task.cancel)
    reloads: set[asyncio.Task[None]] = set()

    def reload() -> None:
        reloads.add(reloading := loop.create_task(runner.reload()))
        reloading.add_done_callback(reloads.discard)

    if runner.identity is not None:
        loop.add_signal_handler(signal.SIGHUP, reload)
    with contextlib.suppress(asyncio.CancelledError):
        await task


def run_coroutine(job: Coroutine[Any, Any, int]) -> None:
    """Run a coroutine to its exit code; Ctrl-C is 130, SIGTERM 143. Both let it take leave of what it started."""
    import asyncio

    with errors_as_lines():
        try:
            code = asyncio.run(_until_sigterm(job))
        except KeyboardInterrupt:
            code = 128 + signal.SIGINT
        raise typer.Exit(code)


async def _until_sigterm(job: Coroutine[Any, Any, int]) -> int:
    import asyncio

    running = asyncio.ensure_future(job)
    was_terminated = False

    def terminate() -> None:
        nonlocal was_terminated
        was_terminated = True
        running.cancel()

    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, terminate)
    try:
        return await running
    except asyncio.CancelledError:
        if not was_terminated:
            raise
        return 128 + signal.SIGTERM
