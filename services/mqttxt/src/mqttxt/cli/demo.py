"""`mqttxt demo`: simulated drones on this machine."""

from __future__ import annotations

from typing import Annotated

import typer

from .common import check_system, errors_as_lines, run


def demo(
    open_page: Annotated[bool, typer.Option("--open", help="Open the page in a browser, too.")] = False,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Show also what each part writes.")] = False,
) -> None:
    """Fly four simulated drones on this machine, on a page in the browser, until Ctrl-C; without Docker."""
    check_system("demo")
    from ..demo.process import Demo

    async def job() -> None:
        await Demo(typer.echo, verbose, open_page).run()

    with errors_as_lines():
        run(job())
