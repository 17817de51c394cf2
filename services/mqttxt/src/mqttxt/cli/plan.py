"""`mqttxt gs plan`: plans as QGroundControl writes them, onto a drone and back."""

from __future__ import annotations

import contextlib
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..protocol.states import Fence, Mission
from ..protocol.topics import MAX_DRONE, check_number
from .advice import connect, line_of
from .common import errors_as_lines, run_coroutine, set_up_logging
from .station import StationOptions, of_a_station

if TYPE_CHECKING:
    from ..station.heard import SentCommand
    from ..station.outcomes import Outcome
    from ..station.plan import Plan
    from ..station.views import Drone

plan_app = typer.Typer(
    help="A drone's mission, geofence and rally points.", no_args_is_help=True, rich_markup_mode=None
)

DroneNumber = Annotated[int, typer.Option("--drone", help="The drone's number.")]
FogNumber = Annotated[int, typer.Option("--fog", help="The fog's number.")]
File = Annotated[Path, typer.Argument(help="A .plan file of QGroundControl.")]
TakeOver = Annotated[bool, typer.Option("--take-over", help="Take control, if another station has it.")]
Item = Annotated[int, typer.Option(help="The item to begin with, counted from 1.", min=1, max=2**16 - 1)]


@plan_app.command()
@of_a_station
def upload(
    options: StationOptions,
    file: File,
    drone: DroneNumber,
    fog: FogNumber = 1,
    take_over: TakeOver = False,
) -> None:
    """Replace a drone's plan by the one in a file; exit code 0 only if the drone read it back."""

    async def job(there: Drone) -> int:
        outcome = await there.upload(plan)
        typer.echo(line_of(outcome))
        return 0 if outcome.completed else 1

    plan = _loaded(file)
    run_with_drone(job, options, drone, fog, take_over)


@plan_app.command()
@of_a_station
def download(
    options: StationOptions,
    file: File,
    drone: DroneNumber,
    fog: FogNumber = 1,
    take_over: TakeOver = False,
) -> None:
    """Write the plan that a drone's autopilot has now into a file, which QGroundControl opens."""

    async def job(there: Drone) -> int:
        plan = await there.download()
        plan.save(file)
        typer.echo(f"{file}: {plan}")
        return 0

    run_with_drone(job, options, drone, fog, take_over)


@plan_app.command()
@of_a_station
def start(
    options: StationOptions,
    file: File,
    drone: DroneNumber,
    item: Item = 1,
    fog: FogNumber = 1,
    take_over: TakeOver = False,
) -> None:
    """Fly the mission of a file, if that is the one that the drone has, and print each word up to its end."""

    async def job(there: Drone) -> int:
        return await _followed(there.start_mission(plan, item))

    plan = _loaded(file)
    run_with_drone(job, options, drone, fog, take_over)


@plan_app.command()
@of_a_station
def clear(
    options: StationOptions,
    drone: DroneNumber,
    fog: FogNumber = 1,
    take_over: TakeOver = False,
) -> None:
    """Remove a drone's mission, geofence and rally points."""

    async def job(there: Drone) -> int:
        return await _followed(there.clear_plan())

    run_with_drone(job, options, drone, fog, take_over)


@plan_app.command()
@of_a_station
def watch(
    options: StationOptions,
    drone: DroneNumber,
    fog: FogNumber = 1,
) -> None:
    """Print which item of its mission a drone is at, and whether it is outside its geofence, until Ctrl-C."""
    from ..station.outcomes import StateUpdate

    set_up_logging(verbose=False)

    async def job() -> int:
        number = check_number("--drone", drone, MAX_DRONE)
        async with options.station(control=False) as station:
            events = station.events()
            await connect(station, [fog], options.timeout)
            async for event in events:
                if (
                    isinstance(event, StateUpdate)
                    and event.drone == number
                    and isinstance(event.state, Mission | Fence)
                ):
                    typer.echo(_told(event.state))
        return 0

    run_coroutine(job())


def run_with_drone(
    job: Callable[[Drone], Awaitable[int]],
    options: StationOptions,
    drone: int,
    fog: int,
    take_over: bool,
) -> None:
    """Do something with a drone that this station controls, as far as it may."""
    set_up_logging(verbose=False)

    async def with_drone() -> int:
        number = check_number("--drone", drone, MAX_DRONE)
        async with options.station() as station:
            (found,) = await connect(station, [fog], options.timeout)
            there = found.drone(number)
            if take_over:
                await there.take_over(options.timeout)
            with contextlib.suppress(TimeoutError):  # who controls it instead is in the word, or in the error
                await station.wait_until(lambda: there.is_controlled, options.timeout)
            return await job(there)

    run_coroutine(with_drone())


def _loaded(path: Path) -> Plan:
    """A plan file; what is wrong with it is said before anything is connected to."""
    from ..station.plan import Plan

    with errors_as_lines():
        return Plan.load(path)


async def _followed(sent: SentCommand[Outcome, Outcome]) -> int:
    """Print each word; the exit code."""
    async for said in sent:
        typer.echo(line_of(said))
    return 0 if (await sent).completed else 1


def _told(state: Mission | Fence) -> str:
    """A state in words."""
    named = state.mission if isinstance(state, Mission) else state.fence
    name = f" ({named.hex()[:8]})" if named is not None else ""
    if isinstance(state, Mission):
        return f"mission{name}: item {state.current} of {state.total}, reached {state.reached}"
    return f"fence{name}: {'outside' if state.breached else 'inside'}"
