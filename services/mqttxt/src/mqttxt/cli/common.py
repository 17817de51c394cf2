"""Common to the subcommands: how errors end a process, logging, and running a role until a signal.

asyncio is imported only where something runs: with ssl it is a quarter of a command's start, and help needs neither.
"""

from __future__ import annotations

import contextlib
import gc
import logging
import re
import signal
import sys
from collections.abc import Callable, Coroutine, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from ..core.printable import printable
from ..core.settings import Settings
from ..errors import ConfigurationError, MqttxtError
from ..protocol.values import Encoding

if TYPE_CHECKING:
    from ..core.audit_log import AuditLog
    from ..core.runner import Runner
    from ..core.transport import Transport

T = TypeVar("T")

IdentityFolder = Annotated[
    Path | None,
    typer.Option("--identity", help="The folder of this node's identity, for mqtts:// (`mqttxt keys issue`)."),
]
SIGNED_HELP = "Sign, and hear only what is signed; takes --identity. The whole fleet, or none of it."
SIGNED_STATES_HELP = "Sign states too; takes --signed. The whole fleet, or none of it."
SIGNED_READINGS_HELP = "Hear only readings that their sensors signed; takes --signed. The whole fleet."
INSECURE_HELP = "Allow mqtt:// to other machines: whoever is there commands the drones."

Signed = Annotated[bool, typer.Option("--signed", help=SIGNED_HELP)]
SignedStates = Annotated[bool, typer.Option("--signed-states", help=SIGNED_STATES_HELP)]
SignedReadings = Annotated[bool, typer.Option("--signed-readings", help=SIGNED_READINGS_HELP)]
Insecure = Annotated[bool, typer.Option("--insecure", help=INSECURE_HELP)]

_RANGE = re.compile("([0-9]{1,9})-([0-9]{1,9})")
_PARAMETER = re.compile("`(identity|insecure|signed|signed_readings|signed_states)`")

AuditPath = Annotated[
    Path | None,
    typer.Option("--audit", help="File for the audit log: who commanded what, with which last word; without: none."),
]
AuditRequired = Annotated[
    bool,
    typer.Option(
        "--audit-required",
        help="Deny commands, except hold, land and return, while the disk takes no audit log; without: warn.",
    ),
]


def as_options(text: str) -> str:
    """A text of the library, in which parameters that are options too are named as these: `identity` as --identity."""
    return _PARAMETER.sub(lambda found: f"--{found[1].replace('_', '-')}", text)


@contextlib.contextmanager
def errors_as_lines() -> Iterator[None]:
    """Print an MqttxtError as its lines, mostly one, on stderr, and exit with its code."""
    try:
        yield
    except MqttxtError as error:
        for line in error.lines:
            typer.echo(printable(f"mqttxt: {as_options(line)}"), err=True)
        raise typer.Exit(error.exit_code) from None


@contextlib.contextmanager
def named(option: str) -> Iterator[None]:
    """Prefix a ConfigurationError about an option's value with the option."""
    try:
        yield
    except ConfigurationError as error:
        text = str(error).removeprefix(f"{option} ").removeprefix(f"{option.removeprefix('--')} ")
        raise ConfigurationError(f"{option} {text}") from None


@contextlib.contextmanager
def readable_expected() -> Iterator[None]:
    """Add the expectation to the error of a file that cannot be read."""
    try:
        yield
    except ConfigurationError as error:
        if isinstance(error.__cause__, OSError):
            raise ConfigurationError(f"{error}; expected a file that can be read") from error.__cause__
        raise


def numbers_of(text: str, most: int, what: str) -> frozenset[int]:
    """Parse whole numbers from 1 to `most`, as `1-3,7`; raises ConfigurationError prefixed with `what`."""
    from ..security.rights import parse_numbers

    for first, last in _RANGE.findall(text):
        if int(first) > int(last):
            raise ConfigurationError(f"{what}: {text[:80]!r}: {first}-{last} is reversed; expected {last}-{first}")
    return parse_numbers(text, most, what)


class _Lines(logging.Formatter):
    """Keeps a message to one line, whatever received texts it has, and names options."""

    def formatMessage(self, record: logging.LogRecord) -> str:
        record.message = printable(as_options(record.message))
        return super().formatMessage(record)


def set_up_logging(verbose: bool) -> None:
    """Log to stderr."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_Lines("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    logging.basicConfig(handlers=[handler], level=logging.DEBUG if verbose else logging.INFO)


def settings(qos: int, json: bool, bundles: bool = False) -> Settings:
    """The settings common to all roles; raises ConfigurationError."""
    if qos not in (0, 1):
        raise ConfigurationError(f"--qos {qos}: expected 0 or 1")
    return Settings(qos=qos, encoding=Encoding.JSON if json else Encoding.CBOR, bundles=bundles)


def audit_log(path: Path | None, required: bool, node: str, transport: Transport) -> AuditLog | None:
    """The audit log of a node, None without a path; raises ConfigurationError."""
    from ..core.audit_log import AuditLog

    if path is None:
        if required:
            raise ConfigurationError("--audit-required: expected --audit FILE beside it")
        return None
    return AuditLog(path, node, transport.identity, required)


def check_system(role: str) -> None:
    """End the command with one line if a role that needs POSIX is started on Windows."""
    with errors_as_lines():
        if sys.platform == "win32":
            raise ConfigurationError(f"{role}: runs on Linux and macOS, not on Windows; expected one of those, or WSL")


def run(job: Coroutine[Any, Any, T]) -> T:
    """Run a coroutine to its result, in an event loop that watches sockets; Windows' default loop does not."""
    import asyncio

    with asyncio.Runner(loop_factory=asyncio.SelectorEventLoop) as runner:
        return runner.run(job)


def on_signal(number: int, act: Callable[[], object]) -> None:
    """Call `act` in the running event loop when a signal arrives, even if the loop has no signal handlers (Windows)."""
    import asyncio

    loop = asyncio.get_running_loop()
    try:
        loop.add_signal_handler(number, act)
    except NotImplementedError:
        signal.signal(number, lambda *_: loop.call_soon_threadsafe(act))


def run_role(make: Callable[[], Runner]) -> None:
    """Run a role until SIGTERM or SIGINT, which end it cleanly (exit code 0).

    With an identity SIGHUP reloads it with its revocation list; without, it ends the process as usual. systemd gets the
    role's status.
    """
    # A message makes many objects that live for microseconds, without cycles: collecting cycles less often saves a
    # tenth of an activator's time. Objects of the imports are never collected.
    gc.freeze()
    gc.set_threshold(50_000, 20, 50)
    with errors_as_lines():
        run(_until_signal(make))


async def _until_signal(make: Callable[[], Runner]) -> None:
    import asyncio

    from ..core.service import Service

    loop = asyncio.get_running_loop()
    runner = make()
    runner.service = Service.of()
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
    """Run a coroutine to its exit code; Ctrl-C gives 130, SIGTERM 143. Both let it clean up first."""
    with errors_as_lines():
        try:
            code = run(_until_sigterm(job))
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

    on_signal(signal.SIGTERM, terminate)
    try:
        return await running
    except asyncio.CancelledError:
        if not was_terminated:
            raise
        return 128 + signal.SIGTERM
