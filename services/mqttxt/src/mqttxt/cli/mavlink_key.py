"""`mqttxt keys mavlink`: the key that an autopilot shares with its UAV client."""

from __future__ import annotations

import hashlib
import secrets
from pathlib import Path
from typing import Annotated

import typer

from ..errors import ConfigurationError
from ..protocol.names import MAX_DRONE, check_number
from .common import errors_as_lines, run_coroutine, set_up_logging

SHORTEST = 16


def mavlink(
    file: Annotated[Path, typer.Argument(help="The key's file; made where it is not there.")],
    passphrase: Annotated[
        bool, typer.Option("--passphrase", help="Make the key of a passphrase that is asked for, as MAVProxy does.")
    ] = False,
    install: Annotated[
        str | None,
        typer.Option(help="Bring the key to an autopilot by wire: serial:DEVICE:BAUD. It travels in the clear."),
    ] = None,
    drone: Annotated[int | None, typer.Option(help="With --install: the autopilot's MAVLink system id.")] = None,
    old: Annotated[Path | None, typer.Option(help="With --install: the key's file that the autopilot has now.")] = None,
) -> None:
    """Make the key of one drone's MAVLink signing, for `mqttxt uav --mavlink-key`, and bring it to the autopilot."""
    with errors_as_lines():
        if install is None:
            if old is not None or drone is not None:
                raise ConfigurationError("--drone, --old: expected --install beside them")
            _make(file, passphrase)
            return
        if drone is None:
            raise ConfigurationError("--install: expected --drone, the autopilot's MAVLink system id, beside it")
        check_number("--drone", drone, MAX_DRONE)
        _install(file, passphrase, install, drone, old)


def _make(file: Path, passphrase: bool) -> None:
    from ..security import files

    if files.is_there(file):
        raise ConfigurationError(f"{file}: exists; expected another name, because an autopilot may have this key")
    key = _of_passphrase() if passphrase else secrets.token_bytes(32)
    files.write(file, f"{key.hex()}\n".encode(), 0o600)
    typer.echo(f"{file}: a MAVLink key; keep it secret, and give each drone its own")


def _of_passphrase() -> bytes:
    words = typer.prompt("Passphrase", hide_input=True, confirmation_prompt=True)
    if len(words) < SHORTEST:
        raise ConfigurationError(
            f"passphrase: {len(words)} characters; expected {SHORTEST} or more, "
            "because whoever recorded one message can try them out"
        )
    try:
        return hashlib.sha256(words.encode()).digest()
    except UnicodeEncodeError:  # its text would contain the passphrase
        raise ConfigurationError("passphrase: not UTF-8; expected text in UTF-8") from None


def _install(file: Path, passphrase: bool, address: str, drone: int, old: Path | None) -> None:
    from ..drone.mavlink.key_install import Installation, check_wired
    from ..drone.mavlink.signing import read_key
    from ..drone.mavlink.transports import AutopilotAddress
    from ..security import files

    wire = AutopilotAddress.parse(address)
    check_wired(wire)
    old_key = read_key(old) if old is not None else None
    if not files.is_there(file):
        _make(file, passphrase)
    elif passphrase:
        raise ConfigurationError(f"--passphrase: {file} exists; expected one of the two")
    key = read_key(file)
    typer.echo(f"{wire}: the key travels in the clear; see that this is a wire, and no radio", err=True)

    async def run() -> int:
        await Installation(wire, drone, key, old_key).run()
        return 0

    typer.echo(f"waiting for drone {drone} to sign")
    set_up_logging(verbose=False)
    run_coroutine(run())
