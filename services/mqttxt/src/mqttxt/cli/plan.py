"""`mqttxt gs plan`: uploads and downloads plans in QGroundControl's format, and flies their missions."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import ConfigurationError
from .advice import connect, follow, line_of, told_without_last_word
from .common import readable_expected, run_coroutine, set_up_logging
from .station import DroneNumber, FogNumber, Job, StationOptions, of_a_station, with_a_drone

if TYPE_CHECKING:
    from ..protocol.states import Fence, Mission
    from ..station.heard import SentCommand
    from ..station.outcomes import Outcome
    from ..station.plan import Plan
    from ..station.views import Drone

plan_app = typer.Typer(
    help="A drone's mission, geofence and rally points.", no_args_is_help=True, rich_markup_mode=None
)

File = Annotated[Path, typer.Argument(help="A .plan file of QGroundControl.")]
Item = Annotated[int, typer.Option(help="The item to begin with, counted from 1.")]


@plan_app.command()
@with_a_drone
def upload(file: File) -> Job:
    """Replace a drone's plan by the one in a file; exit code 0 only if the drone read it back."""
    plan = _loaded(file)

    async def job(there: Drone) -> int:
        with told_without_last_word():
            outcome = await there.upload(plan)
        typer.echo(line_of(outcome))
        return 0 if outcome.completed else 1

    return job


@plan_app.command()
@with_a_drone
def download(file: File) -> Job:
    """Write the plan that a drone's autopilot has now into a file, which QGroundControl opens."""
    from ..security.files import named_by_user

    named_by_user(file)

    async def job(there: Drone) -> int:
        plan = await there.download()
        plan.save(file)
        typer.echo(f"{file}: {plan}")
        return 0

    return job


@plan_app.command()
@with_a_drone
def start(file: File, item: Item = 1) -> Job:
    """Fly the mission of a file, if that is the one that the drone has, and print each word up to its end."""
    if not 1 <= item < 2**16:
        raise ConfigurationError(f"--item {item}: expected a whole number from 1 to {2**16 - 1}")
    plan = _loaded(file)

    async def job(there: Drone) -> int:
        return await _followed(there.start_mission(plan, item))

    return job


@plan_app.command()
@with_a_drone
def clear() -> Job:
    """Remove a drone's mission, geofence and rally points."""

    async def job(there: Drone) -> int:
        return await _followed(there.clear_plan())

    return job


@plan_app.command()
@of_a_station
def watch(
    options: StationOptions,
    drone: DroneNumber,
    fog: FogNumber = "1",
) -> None:
    """Print which item of its mission a drone is at, and whether it is outside its geofence, until Ctrl-C."""
    from ..protocol.states import Fence, Mission
    from ..station.outcomes import StateUpdate

    set_up_logging(verbose=False)

    async def job() -> int:
        fleet, place, number = options.place_of(drone, fog)
        async with options.station(fleet, control=False) as station:
            events = station.events()
            await connect(station, {fleet: [place]}, options.timeout)
            async for event in events:
                if (
                    isinstance(event, StateUpdate)
                    and event.drone == number
                    and isinstance(event.state, Mission | Fence)
                ):
                    typer.echo(_told(event.state))
        return 0

    run_coroutine(job())


def _loaded(path: Path) -> Plan:
    from ..station.plan import Plan

    with readable_expected():
        return Plan.load(path)


async def _followed(sent: SentCommand[Outcome, Outcome]) -> int:
    """Print each word; returns the exit code."""
    await follow(sent)
    return 0 if (await sent).completed else 1


def _told(state: Mission | Fence) -> str:
    """A state in words."""
    from ..protocol.states import Mission

    named = state.mission if isinstance(state, Mission) else state.fence
    name = f" ({named.hex()[:8]})" if named is not None else ""
    if isinstance(state, Mission):
        return f"mission{name}: item {state.current} of {state.total}, reached {state.reached}"
    return f"fence{name}: {'outside' if state.breached else 'inside'}"
