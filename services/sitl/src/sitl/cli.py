"""The `sitl` command."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import signal
import socket
import sys
import tempfile
from collections.abc import Coroutine, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from .control_socket import served
from .errors import SitlError
from .fleet import DroneConfig, load
from .personalities import PERSONALITIES
from .process import LinkConfig, Process
from .px4.personality import PX4
from .px4.streams import SETS
from .real.ardupilot import ArduCopter
from .real.autopilot import Autopilot
from .real.process import fly as fly_real
from .real.px4 import Px4
from .real.watching import Watching
from .signing import read_key
from .vehicle import Vehicle

STAND_IN = "stand-in"
REAL: dict[str, type[Autopilot]] = {"px4": Px4, "ardupilot": ArduCopter}
AUTOPILOTS = (STAND_IN, *REAL)
WITNESS = ("127.0.0.1", 14540)
"""The address where a real autopilot is watched, on a link of its own.

Drone N's own port is N more, from 14541 on: 14550 would be drone 10's.
"""

_USAGE: Any = typer.BadParameter.__mro__[1]
"""The base class of typer's usage errors, which typer does not export."""

app = typer.Typer(
    name="sitl",
    help="An autopilot stand-in, like PX4 or ArduPilot's ArduCopter.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


@app.callback()
def about() -> None:
    """An autopilot stand-in, like PX4 or ArduPilot's ArduCopter."""


@app.command()
def fly(
    system: Annotated[int, typer.Option(help="MAVLink system id, 1 to 250.")] = 1,
    fleet: Annotated[Path | None, typer.Option(help="The fleet in YAML, with PX4's names; defaults without.")] = None,
    listen: Annotated[str, typer.Option(help="HOST:PORT to receive on.")] = "127.0.0.1:14580",
    send: Annotated[str, typer.Option(help="HOST:PORT to send to.")] = "127.0.0.1:14540",
    streams: Annotated[str, typer.Option(help=f"What it streams as PX4: {', '.join(SETS)}.")] = "px4-onboard",
    gcs: Annotated[bool, typer.Option("--gcs", help="Also PX4's link for ground stations, 18570 to 14550.")] = False,
    events: Annotated[Path | None, typer.Option(help="File for what happens, JSON lines.")] = None,
    control: Annotated[Path | None, typer.Option(help="Unix socket of the side channel.")] = None,
    ready_file: Annotated[Path | None, typer.Option(help="File touched every second while flying.")] = None,
    position_file: Annotated[
        Path | None, typer.Option(help="File with the drone's place, replaced five times a second.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the sensors' noise.")] = 1,
    autopilot: Annotated[
        str, typer.Option(help=f"What flies: {', '.join(AUTOPILOTS)}.", envvar="SITL_AUTOPILOT")
    ] = STAND_IN,
    folder: Annotated[
        Path, typer.Option(help="Where a real autopilot is: bin/px4 and etc, or arducopter and copter.parm.")
    ] = Path("/opt/autopilot"),
    like: Annotated[
        str | None, typer.Option(help=f"Whom the stand-in is like: {', '.join(PERSONALITIES)}; px4 without.")
    ] = None,
    mavlink_key: Annotated[
        Path | None, typer.Option(help="The stand-in's MAVLink key: it signs, and takes no unsigned commands.")
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Without noise: what it says is true.")] = False,
) -> None:
    """Fly one simulated drone until Ctrl-C; a real autopilot's log goes beside its events."""
    logging.basicConfig(stream=sys.stderr, level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s")
    with _errors_as_lines():
        if not 1 <= system <= 250:
            raise SitlError(f"--system {system}: expected 1 to 250")
        if streams not in SETS:
            raise SitlError(f"--streams {streams!r}: expected one of {', '.join(SETS)}")
        if like is not None and like not in PERSONALITIES:
            raise SitlError(f"--like {like!r}: expected one of {', '.join(PERSONALITIES)}")
        if autopilot not in AUTOPILOTS:
            raise SitlError(f"--autopilot {autopilot!r}: expected one of {', '.join(AUTOPILOTS)}")
        if like is not None and autopilot != STAND_IN:
            raise SitlError(f"--like {like!r}: {autopilot} is like itself; expected without --like")
        if mavlink_key is not None and autopilot != STAND_IN:
            raise SitlError(f"--mavlink-key {mavlink_key}: of the stand-in alone; a real autopilot keeps its own")
        config = replace(load(fleet, system) if fleet is not None else DroneConfig(system), quiet=quiet)
        links = [LinkConfig(_address("--listen", listen), _reachable("--send", send), streams)]
        if autopilot != STAND_IN:
            told = {"events": events, "ready_file": ready_file, "position_file": position_file}
            work = Path(tempfile.gettempdir()) / f"{autopilot}-{system}"
            logs = events.with_suffix(".log") if events is not None else work.with_suffix(".log")
            flown = REAL[autopilot](folder, work, logs, config, links[0], WITNESS[1])
            asyncio.run(_until_signal(_fly_real(flown, Watching(system, WITNESS, **told), autopilot, control)))
            return
        kind = PX4 if like is None else PERSONALITIES[like]
        if gcs:
            links.append(LinkConfig(("127.0.0.1", 18569 + system), ("127.0.0.1", 14550), "px4-gcs"))
            typer.echo(_how_to_connect(kind.title, system, links[0]))
        vehicle = Vehicle(config, [link.streams for link in links], seed, kind)
        files = {"events": events, "control": control, "ready_file": ready_file, "position_file": position_file}
        key = read_key(mavlink_key) if mavlink_key is not None else None
        process = Process(vehicle, links, **files, key=key)
        asyncio.run(_until_signal(process.run()))


@app.command()
def watch(
    system: Annotated[int, typer.Option(help="MAVLink system id, 1 to 250.")],
    events: Annotated[Path, typer.Option(help="File for what happens, JSON lines.")],
    listen: Annotated[str, typer.Option(help="HOST:PORT to receive on.")] = "127.0.0.1:14550",
    ready_file: Annotated[
        Path | None, typer.Option(help="File touched while it tells where it is, and would arm.")
    ] = None,
    position_file: Annotated[
        Path | None, typer.Option(help="File with the drone's place, replaced five times a second.")
    ] = None,
) -> None:
    """Write down what an autopilot that was started elsewhere does, by its own messages, until it is ended."""
    with _errors_as_lines():
        files = {"events": events, "ready_file": ready_file, "position_file": position_file}
        asyncio.run(_until_signal(Watching(system, _address("--listen", listen), **files).run()))


@app.command()
def record(
    output: Annotated[Path, typer.Argument(help="The recording in JSON; flights that are in it stay.")],
    px4_dir: Annotated[Path | None, typer.Option(help="A PX4 with its simulator: a folder with bin and etc.")] = None,
    ardupilot_dir: Annotated[
        Path | None, typer.Option(help="An ArduCopter with its simulator: a folder with arducopter and copter.parm.")
    ] = None,
    stand_in: Annotated[
        str | None, typer.Option(help=f"The stand-in as a process, in real time, like: {', '.join(PERSONALITIES)}.")
    ] = None,
    instance: Annotated[int, typer.Option(help="Its instance, 0 to 249; its ports follow from it.")] = 0,
    cases: Annotated[list[str] | None, typer.Option("--case", help="Only this case; can be repeated.")] = None,
) -> None:
    """Fly cases on an autopilot, started for it on loopback, and write down what it did: numbers and times."""
    from .likeness import commands as likeness

    signal.signal(signal.SIGTERM, signal.default_int_handler)  # so that the autopilot ends with its recorder
    with _errors_as_lines():
        likeness.record_into(output, likeness.subject(px4_dir, ardupilot_dir, stand_in, instance), cases or [], _say)


@app.command()
def compare(
    recording: Annotated[Path | None, typer.Argument(help="What is compared with; PX4 main's without.")] = None,
    other: Annotated[Path | None, typer.Argument(help="Another one; the stand-in in simulated time without.")] = None,
    write: Annotated[Path | None, typer.Option(help="A page, whose table of it is made anew.")] = None,
) -> None:
    """Say where two recordings differ by more than they may; exit code 1 if they do."""
    from .likeness import commands as likeness

    with _errors_as_lines():
        differing = likeness.compare_with(recording, other, write, _say)
    for line in differing:
        typer.echo(line)
    raise typer.Exit(1 if differing else 0)


def _say(text: str) -> None:
    typer.echo(text, err=True)


@contextlib.contextmanager
def _errors_as_lines() -> Iterator[None]:
    try:
        yield
    except SitlError as error:
        typer.echo(f"sitl: {error}", err=True)
        raise typer.Exit(error.exit_code) from None


async def _fly_real(flown: Autopilot, watching: Watching, kind: str, control: Path | None) -> None:
    async with contextlib.AsyncExitStack() as stack:
        if control is not None:
            from .likeness.placing import Placing

            await stack.enter_async_context(served(control, Placing(watching, kind).answer))
        await fly_real(flown, watching)


async def _until_signal(flight: Coroutine[Any, Any, None]) -> None:
    task = asyncio.create_task(flight)
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(number, task.cancel)
    with contextlib.suppress(asyncio.CancelledError):
        await task


def _address(option: str, text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal() or not 0 <= int(port) < 65_536:
        raise SitlError(f"{option} {text!r}: expected HOST:PORT")
    return host, int(port)


def _reachable(option: str, text: str) -> tuple[str, int]:
    """The numeric address of HOST:PORT, for sending."""
    host, port = _address(option, text)
    try:
        found = socket.getaddrinfo(host, port, socket.AF_INET, socket.SOCK_DGRAM)
    except OSError as error:
        raise SitlError(f"{option} {text!r}: {error.strerror}") from error
    if port == 0:
        raise SitlError(f"{option} {text!r}: expected a port from 1 to 65535")
    return str(found[0][4][0]), port


def _how_to_connect(title: str, system: int, onboard: LinkConfig) -> str:
    host, port = onboard.send
    return f"""\
A simulated {title} multicopter flies on loopback; Ctrl-C ends it.
  QGroundControl   connects by itself (UDP 14550)
  MAVSDK           await mavsdk.add_any_connection("udpin://{host}:{port}")
  MAVProxy         mavproxy.py --master=udp:{host}:{port}
  MQTT-XT          mqttxt uav --drone {system} --broker mqtt://HOST:1883 --autopilot udp:{host}:{port}"""


def main() -> None:
    """Entry point of the `sitl` command."""
    try:
        sys.exit(app(standalone_mode=False))
    except typer.Abort:
        sys.exit(1)
    except _USAGE as error:
        if message := " ".join(error.format_message().split()):
            typer.echo(f"sitl: {message}", err=True)
        sys.exit(error.exit_code)
