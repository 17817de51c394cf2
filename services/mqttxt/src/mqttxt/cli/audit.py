"""`mqttxt audit`: checks that an audit log is unchanged."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..core.printable import printable
from ..errors import AuditBroken
from .common import errors_as_lines

audit_app = typer.Typer(
    help="Audit logs: who commanded what, when, with which last word.",
    no_args_is_help=True,
    rich_markup_mode=None,
)


@audit_app.callback()
def _of_all() -> None:
    """What every subcommand has."""


@audit_app.command()
def verify(
    files: Annotated[list[Path], typer.Argument(help="Audit logs; the older files of FILE, FILE.NUMBER, come along.")],
    fleet: Annotated[
        Path | None,
        typer.Option(help="The folder of the authority or of any identity, whose fleet has to have signed the logs."),
    ] = None,
) -> None:
    """Say of each log whether it is whole, in one line: up to which line, and up to when signed by whom.

    The first line that is not as it was written is named, with exit code 1.
    """
    from ..security.audit_verdict import AuditVerdict, logs_of
    from ..security.fleet import Fleet

    with errors_as_lines():
        known = Fleet.load(fleet) if fleet is not None else None
        is_broken = False
        for log, parts in logs_of(files).items():
            verdict = AuditVerdict(known)
            try:
                verdict.read(parts)
            except AuditBroken as error:
                is_broken = True
                typer.echo(printable(f"mqttxt: {error}"), err=True)
            else:
                typer.echo(printable(f"{log}: {verdict.summary()}"))
        if is_broken:
            raise typer.Exit(AuditBroken.exit_code)
