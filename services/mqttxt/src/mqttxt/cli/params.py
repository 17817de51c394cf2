"""`mqttxt gs params`: the parameters of a drone's autopilot, and QGroundControl's `.params` files."""

from __future__ import annotations

import logging
import os
from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Annotated
from urllib.parse import quote

import typer

from ..errors import ConfigurationError, PayloadError
from .advice import told_without_last_word
from .common import readable_expected
from .station import Job, with_a_drone

if TYPE_CHECKING:
    from ..protocol.parameters import Parameter
    from ..station.parameters import Parameters
    from ..station.views import Drone

logger = logging.getLogger("mqttxt.parameters")
params_app = typer.Typer(help="The parameters of a drone's autopilot.", no_args_is_help=True, rich_markup_mode=None)

File = Annotated[Path, typer.Argument(help="A .params file of QGroundControl.")]
AT_ONCE = 8
"""The most commands under way to a drone at a time: it sets one parameter after the other."""
TTL_S = 30.0


@params_app.command("list")
@with_a_drone
def list_(pattern: Annotated[str, typer.Argument(help="Names, as 'MPC_*'.")] = "*") -> Job:
    """Print the parameters that a drone's autopilot has now: name, value and type."""

    async def job(there: Drone) -> int:
        found = [one for one in (await _fetched(there)).content if fnmatchcase(one.name, pattern)]
        for one in found:
            typer.echo(f"{one.name:<16} {one!s:<16} {one.type.label}")
        return 0 if found else 1

    return job


@params_app.command()
@with_a_drone
def get(names: Annotated[list[str], typer.Argument(help="Names of parameters.")]) -> Job:
    """Print the values of parameters, a line each, in the order of the names."""

    async def job(there: Drone) -> int:
        known = (await _fetched(there)).content.parameters
        for name in names:
            if name not in known:
                raise ConfigurationError(f"{name}: drone {there.number} has no such parameter")
        for name in names:
            typer.echo(str(known[name]))
        return 0

    return job


@params_app.command("set", context_settings={"ignore_unknown_options": True})  # the number may be negative
@with_a_drone
def set_(
    name: Annotated[str, typer.Argument(help="The parameter's name.")],
    value: Annotated[str, typer.Argument(help="The number to set it to.")],
) -> Job:
    """Set a parameter; exit code 0 only if the drone read it back as that value."""
    from .parameters import parse_command

    command = parse_command("set_parameter", [name, value])

    async def job(there: Drone) -> int:
        with told_without_last_word():
            last = await there.send(command)
        typer.echo(str(last))
        return 0 if last.completed else 1

    return job


@params_app.command()
@with_a_drone
def save(file: File) -> Job:
    """Write the parameters that a drone's autopilot has now into a file, which QGroundControl opens."""
    from ..security.files import named_by_user

    named_by_user(file)

    async def job(there: Drone) -> int:
        found = await _fetched(there)
        found.save(file, there.number)
        typer.echo(f"{file}: {len(found)} parameters")
        return 0

    return job


@params_app.command()
@with_a_drone
def load(file: File) -> Job:
    """Set each parameter whose value in a file is another than the drone's; exit code 0 only if all of them were set.

    Nothing is set where the drone does not have one of them, or has it with another type.
    """
    wanted = _loaded(file)

    async def job(there: Drone) -> int:
        return await _set_all(there, _to_set(file, wanted, await _fetched(there)))

    return job


@params_app.command()
@with_a_drone
def diff(file: File) -> Job:
    """Print where a file and the drone have different values, the file's first; exit code 1 if they do."""
    wanted = _loaded(file)

    async def job(there: Drone) -> int:
        found = wanted.differences(await _fetched(there))
        for one in found:
            typer.echo(str(one))
        return 1 if found else 0

    return job


def _to_set(file: Path, wanted: Parameters, found: Parameters) -> list[Parameter]:
    """The parameters of a file that differ from the drone's; raises ConfigurationError for one that it cannot take."""
    known, out = found.content.parameters, []
    for one in wanted.content:
        there = known.get(one.name)
        if there is None:
            raise ConfigurationError(f"{file}: {one.name}: the drone has no such parameter; nothing was set")
        if there.type is not one.type:
            kinds = [f"{int(each.type)} ({each.type.label})" for each in (there, one)]
            said = f"type: expected {kinds[0]}, got {kinds[1]}; nothing was set"
            raise ConfigurationError(f"{file}: {one.name}: {said}")
        if there != one and one.value is None:
            raise ConfigurationError(f"{file}: {one.name}: expected a number, got nan; nothing was set")
        if there != one:
            out.append(one)
    return out


async def _set_all(there: Drone, wanted: Sequence[Parameter]) -> int:
    """Set parameters in order, up to AT_ONCE commands at a time; returns the exit code."""
    done = 0
    for first in range(0, len(wanted), AT_ONCE):
        some = wanted[first : first + AT_ONCE]
        sent = [there.set_parameter(one.name, one.value or 0, ttl_s=TTL_S, limit_s=AT_ONCE * 30.0) for one in some]
        for one, command in zip(some, sent, strict=True):
            with told_without_last_word():
                last = await command
            done += last.completed
            typer.echo(f"{one.name} {one}: {last}")
    typer.echo(f"{done} of {len(wanted)} parameters were set")
    return 0 if done == len(wanted) else 1


async def _fetched(there: Drone) -> Parameters:
    """The drone's parameters: the cached ones of an earlier call, and the changes since."""
    from ..protocol.parameters import ParameterSet
    from ..station.parameters import Parameters

    cache = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    path = Path(cache) / "mqttxt" / "parameters" / f"{quote(there.prefix, safe='')}fog{there.fog}-drone{there.number}"
    known = None
    try:
        known = Parameters(ParameterSet.unpacked(path.read_bytes()))
    except (OSError, PayloadError) as error:
        logger.debug("%s: %s", path, error)
    found = await there.parameters(known)
    if found is not known:
        part = path.with_name(f".{path.name}.{os.getpid()}")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            part.write_bytes(found.content.packed())
            os.replace(part, path)
        except OSError as error:
            logger.warning("%s: %s; next time all parameters are fetched", path, error.strerror)
    return found


def _loaded(path: Path) -> Parameters:
    from ..station.parameters import Parameters

    with readable_expected():
        return Parameters.load(path)
