"""Other machines' Docker daemons: by their socket, through SSH where the machine is far, and whether they fit."""

from __future__ import annotations

import contextlib
import subprocess
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from docker.errors import ImageNotFound, StreamParseError
from urllib3.exceptions import HTTPError

from ...errors import DockerError, TestbedError, UserError
from ...plan.compose import PROJECT
from ...plan.machines import VARIABLE, Machine
from ..containers import NO_ANSWER, PROJECT_LABEL, SERVICE_LABEL, connect_docker

SOCKET = "/var/run/docker.sock"
FORWARDED = f"Docker's {SOCKET} there, which this user may use and sshd forwards (AllowStreamLocalForwarding)"
"""Which of these it is not, sshd does not say."""
OPENED_S, ENDED_S = 30.0, 5.0
"""Within which ssh forwards the socket, and ends."""
POLL_S = 0.05
BROKEN_OFF = (HTTPError, StreamParseError)
"""What comes of a stream that ends in its middle: Docker's client passes these on as they are."""
OVERLAY, NET = "overlay", "net"
SSH = ("ssh", "-nNT", *(word for option in (
    "BatchMode=yes", "ConnectTimeout=10", "ServerAliveInterval=5", "ServerAliveCountMax=3",
    "ControlMaster=no", "ControlPath=none",  # one that others share goes on when this one ends
    "ExitOnForwardFailure=no",  # a user's own forwarding may be in use; ours is there when its socket is
    "LogLevel=INFO",  # it says why it ends, and little else
) for word in ("-o", option)))  # fmt: skip


@dataclass(frozen=True)
class Daemon:
    """A machine whose Docker answers at `address`, a socket on this one."""

    machine: Machine
    address: str
    client: Any

    @property
    def name(self) -> str:
        return self.machine.name


@contextlib.contextmanager
def reached(machines: Sequence[Machine], image: str) -> Iterator[tuple[Daemon, ...]]:
    """All of them, each with the node image, for as long as this lasts.

    Raises UserError naming the first that does not answer, does not fit this one, or is the same as another.
    """
    with contextlib.ExitStack() as stack:
        daemons = []
        for machine in machines:
            address = stack.enter_context(_socket_of(machine))
            try:
                client = connect_docker(address)
            except DockerError as error:
                expected = f": expected {FORWARDED}" if address != machine.address else ""
                raise UserError(f"{VARIABLE}: {machine.address}: {in_a_line(error)}{expected}") from error
            stack.callback(client.close)
            daemons.append(Daemon(machine, address, client))
        here = connect_docker()
        stack.callback(here.close)
        _check(here, daemons)
        _refuse_flights(daemons)
        for daemon in daemons:
            _bring_image(here, daemon, image)
        yield tuple(daemons)


def _check(here: Any, daemons: Sequence[Daemon]) -> None:
    known = {_identity(here.info()): "this machine"}
    wanted = here.version()
    for daemon in daemons:
        where = f"{VARIABLE}: {daemon.machine.address}"
        try:
            info, found = daemon.client.info(), daemon.client.version()
            identity, networks = _identity(info), tuple(info["Plugins"]["Network"])
            told = {what: str(found[what]) for what in ("Version", "Arch")}
        except NO_ANSWER as error:
            raise UserError(f"{where}: Docker does not say what it is: {in_a_line(error)}") from error
        if (same := known.get(identity)) is not None:
            raise UserError(f"{where}: its Docker is that of {same}: expected each machine once")
        known[identity] = daemon.machine.address
        for what, value in told.items():
            if value != wanted[what]:
                raise UserError(f"{where}: Docker's {what} is {value}: expected {wanted[what]}, as here")
        if OVERLAY not in networks:
            raise UserError(f"{where}: expected a Docker that has overlay networks")


def _refuse_flights(daemons: Sequence[Daemon]) -> None:
    """A fleet of a machine's own has `net` there; what a run of several machines left there has not."""
    labels = [f"{PROJECT_LABEL}={PROJECT}", f"{SERVICE_LABEL}={NET}"]
    for daemon in daemons:
        with does(f"{VARIABLE}: {daemon.machine.address}", "Docker does not say what runs there", UserError):
            found = daemon.client.api.containers(filters={"label": labels})
        if found:
            raise UserError(
                f"{VARIABLE}: {daemon.machine.address}: a fleet of its own runs there: expected none (make down, there)"
            )


def _identity(info: Mapping[str, Any]) -> tuple[str, str, str]:
    """What tells a daemon from others: machines that were copied have one ID."""
    return info["ID"], info["Name"], info["DockerRootDir"]


def _bring_image(here: Any, daemon: Daemon, image: str) -> None:
    """Load an image of this machine into another's Docker, if it does not have the same."""
    try:
        wanted = here.images.get(image).id
    except ImageNotFound as error:
        raise DockerError(f"{image}: not here; type: make containers") from error
    failure = f"{image} could not be loaded"
    with does(daemon.name, failure):
        with contextlib.suppress(ImageNotFound):
            if daemon.client.images.get(image).id == wanted:
                return
        for said in daemon.client.api.load_image(here.api.get_image(image), quiet=False):  # else silent until its end
            if "error" in said:
                raise DockerError(f"{daemon.name}: {failure}: {in_a_line(said['error'])}")
        found = daemon.client.images.get(image).id
    if found != wanted:
        raise DockerError(f"{daemon.name}: {image} is {found} there: expected {wanted}")


@contextlib.contextmanager
def does(name: str, failure: str, kind: type[TestbedError] = DockerError) -> Iterator[None]:
    """Raises `kind` naming a machine whose Docker does not do what it is asked within this."""
    try:
        yield
    except (*NO_ANSWER, *BROKEN_OFF) as error:
        raise kind(f"{name}: {failure}: {in_a_line(error)}") from error


def in_a_line(text: object) -> str:
    """What another machine says, as one line that only says what it shows."""
    return " ".join("".join(c if c.isprintable() else " " for c in str(text)).split())


@contextlib.contextmanager
def _socket_of(machine: Machine) -> Iterator[str]:
    """The address of a machine's Docker: its own socket's, or that of one that ssh forwards to it.

    Raises UserError naming a machine that ssh does not reach.
    """
    scheme, _, rest = machine.address.partition("://")
    if scheme != "ssh":
        yield machine.address
        return
    target, _, port = rest.partition(":")
    with tempfile.TemporaryDirectory(prefix="mqttxt-testbed-") as folder:
        local, log = Path(folder) / "docker.sock", Path(folder) / "ssh.log"
        words = [*SSH, "-L", f"{local}:{SOCKET}", *(["-p", port] if port else []), target]
        try:
            with log.open("wb") as said:  # a pipe that nobody reads would stop ssh once it is full
                process = subprocess.Popen(
                    words, stdin=subprocess.DEVNULL, stdout=said, stderr=said, start_new_session=True
                )
        except FileNotFoundError as error:
            raise UserError(f"{VARIABLE}: {machine.address}: expected ssh to be installed here") from error
        try:
            _wait_until_forwarded(machine, process, local, log)
            yield f"unix://{local}"
        finally:
            process.terminate()
            try:
                process.wait(ENDED_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def _wait_until_forwarded(machine: Machine, process: subprocess.Popen[bytes], local: Path, log: Path) -> None:
    deadline_s = time.monotonic() + OPENED_S
    while not local.exists():
        if process.poll() is not None:
            said = _last_line(log) or f"ssh ended with exit code {process.returncode}"
            expected = "expected a machine that ssh reaches without asking"
            raise UserError(f"{VARIABLE}: {machine.address}: {said}: {expected}")
        if time.monotonic() > deadline_s:
            said = _last_line(log) or "it says nothing"
            raise UserError(
                f"{VARIABLE}: {machine.address}: ssh has not forwarded {SOCKET} within {OPENED_S:g} s: {said}"
            )
        time.sleep(POLL_S)


def _last_line(log: Path) -> str:
    """The last thing that ssh says, without its full stop; empty where it says nothing."""
    lines = log.read_text(encoding="utf-8", errors="replace").strip().splitlines() or [""]
    return in_a_line(lines[-1]).rstrip(".")
