"""The `mqttxt` command."""

from __future__ import annotations

import io
import sys
from typing import Annotated

import typer

from .. import __version__
from .activator import activator
from .audit import audit_app
from .broker import broker
from .common import errors_as_lines
from .conformance import conformance_app
from .demo import demo
from .gs import gs_app
from .keys import keys_app
from .logs import logs_app
from .mavlink_key import mavlink
from .one_line import OneLineErrors
from .page import page
from .params import params_app
from .plan import plan_app
from .uav import uav

app = typer.Typer(
    name="mqttxt",
    cls=OneLineErrors,
    help="MQTT-XT: drones as ordinary nodes of an IoT network.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
gs_app.add_typer(plan_app, name="plan")
gs_app.add_typer(params_app, name="params")
gs_app.add_typer(logs_app, name="logs")
gs_app.command()(page)
app.add_typer(gs_app, name="gs")
app.add_typer(conformance_app, name="conformance")
keys_app.command()(mavlink)
app.add_typer(keys_app, name="keys")
app.add_typer(audit_app, name="audit")
app.command()(broker)
app.command()(demo)
app.command()(activator)
app.command()(uav)


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"mqttxt {__version__}")
        raise typer.Exit


@app.callback()
def _of_all(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """What every subcommand has."""


def main() -> None:
    """Entry point of the `mqttxt` command."""
    if isinstance(sys.stdout, io.TextIOWrapper):  # a file or pipe on Windows may not encode every character
        sys.stdout.reconfigure(errors="backslashreplace")
    with errors_as_lines():
        app()
