"""The module that calls Docker: starts the fleet, runs commands in it, watches it, and removes it."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Generator, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import Empty, Queue
from typing import Any

import docker
from docker.errors import APIError, DockerException
from requests.exceptions import RequestException

from ..errors import ContainerDied, ContainerUnhealthy, DockerError, FleetError, TestbedError
from ..plan.compose import COMPOSE_FILE, PROJECT, read_services
from ..plan.documents import ROOT
from ..plan.experiments import PROTOCOLS
from ..plan.fleet import Fleet
from ..plan.overrides import compose_files
from ..plan.sensors import SENSOR_PROFILES
from .daemon import Usage, is_healthy, real_time_us, usage_of
from .images import autopilot_in_image

HEALTHY_TIMEOUT_S, HEALTHY_S_A_DRONE = 180.0, 30.0
"""Six real autopilots need 90 s on a busy machine with two cores until GPS and estimator agree."""
POLL_S = 0.5
ANSWER_S = 20
"""Time limit for an answer of another machine's Docker."""
HEALTH_INTERVAL = "24h"
"""Docker's own health checks would take CPU from the flight every few seconds; `start` checks by `is_healthy`."""
LOG_LINES = 12
SERVICE_LABEL = "com.docker.compose.service"
PROJECT_LABEL = "com.docker.compose.project"
NO_ANSWER = (DockerException, RequestException, LookupError, TypeError, ValueError)
"""The errors of a Docker that refuses, does not answer, breaks off, or answers nonsense."""
OURS: dict[str, str | list[str] | bool] = {"label": f"{PROJECT_LABEL}={PROJECT}"}
NODE_USER = "1000:1000"


@contextlib.contextmanager
def _answered() -> Iterator[None]:
    """Raise DockerError if Docker does not answer."""
    try:
        yield
    except (APIError, RequestException) as error:
        raise DockerError(f"Docker does not answer: {error}") from error


class Containers:
    """The containers of one compose profile, and of the profiles that its settings add, for one run."""

    def __init__(
        self,
        profile: str,
        run_dir: Path,
        settings: dict[str, str],
        fleet: Fleet,
        *,
        daemon: str | None = None,
        files: Sequence[Path] = (),
    ) -> None:
        """`daemon` is the address of another machine's Docker; `files` replace the fleet's compose files."""
        self._profiles = (profile, *settings.get("SENSOR_PROFILES", "").split())
        self._files = list(files) or compose_files(settings, fleet, run_dir)
        self._timeout_s = max(HEALTHY_TIMEOUT_S, HEALTHY_S_A_DRONE * len(fleet.fog_of))
        self._compose_limit_s = self._timeout_s if daemon is not None else None  # here compose may fetch an image
        self._client = connect_docker(daemon)
        self._environment = {
            **os.environ,
            "RUN_DIR": str(run_dir),
            **settings,
            **autopilot_in_image(self._client, settings),
            "HEALTH_INTERVAL": HEALTH_INTERVAL,
            "REAL_TIME_US": str(real_time_us()),
            **({"DOCKER_HOST": daemon} if daemon is not None else {}),
        }

    def up(self, *services: str) -> None:
        """Start these services, or all that do not run yet. Raises FleetError with compose's reason."""
        self._compose("up", "--detach", "--no-build", "--no-recreate", *services)

    def start(self, *services: str) -> None:
        """Start these services, or all that do not run yet, and wait until all are healthy.

        Raises FleetError that names a service that is not, and why.
        """
        self.up(*services)
        deadline = time.monotonic() + self._timeout_s
        healthy: set[str] = set()
        while waiting := self._unhealthy(healthy):
            self.check_alive()
            if time.monotonic() > deadline:
                raise ContainerUnhealthy(self._describe(waiting[0], f"not healthy within {self._timeout_s:.0f} s"))
            time.sleep(POLL_S)

    @property
    def count(self) -> int:
        """The number of containers that the profiles have."""
        return len({name for path in self._files for name in services_of(self._profiles, path)})

    @_answered()
    def check_alive(self) -> None:
        """Raise ContainerDied if a container has ended."""
        # one request; the client's own list makes one more per container, every second in flight
        found = self._client.api.containers(all=True, filters=OURS)
        for one in found:
            if one["State"] in ("exited", "dead"):
                container = self._client.containers.get(one["Id"])
                code = container.attrs["State"].get("ExitCode")
                raise ContainerDied(self._describe(container, f"ended with exit code {code}"))

    def execute(
        self, service: str, command: list[str], *, limit_s: float, alive_every_s: float = 1.0
    ) -> Generator[str, None, int]:
        """Run a command in a service; yields its lines, returns its exit code.

        Raises ContainerDied if any container of the fleet ends meanwhile, and FleetError if the command does not end
        within `limit_s`; it then runs on until its container ends.
        """
        container = self._service(service)
        api = self._client.api
        with _answered():
            run_id = api.exec_create(container.id, command, user=NODE_USER)["Id"]
            stream = api.exec_start(run_id, stream=True)
        lines: Queue[str | None] = Queue()
        threading.Thread(target=_read_lines, args=(stream, lines), daemon=True).start()
        looked_s = started_s = time.monotonic()
        while True:
            if time.monotonic() - started_s >= limit_s:
                raise FleetError(f"{service}: {command[0]} did not end within {limit_s:g} s")
            if time.monotonic() - looked_s >= alive_every_s:  # however often the command prints a line
                self.check_alive()
                looked_s = time.monotonic()
            try:
                line = lines.get(timeout=alive_every_s)
            except Empty:
                continue
            if line is None:
                self.check_alive()
                with _answered():
                    code = api.exec_inspect(run_id)["ExitCode"]
                if code is None:
                    raise DockerError(f"{service}: lost touch with {command[0]}, which still runs")
                return int(code)
            yield line

    @_answered()
    def output(self, service: str, command: list[str], user: str = NODE_USER) -> str:
        """Run a short command in a service and return what it prints."""
        result = self._service(service).exec_run(command, user=user)
        return str(result.output.decode(errors="replace"))

    def name_of(self, service: str) -> str:
        """The name of a service's container, as typed in docker commands."""
        return str(self._service(service).name)

    @_answered()
    def save_logs(self, folder: Path) -> None:
        """Save every container's log in `folder`."""
        folder.mkdir(parents=True, exist_ok=True)
        for container in self._all():
            (folder / f"{container.labels[SERVICE_LABEL]}.log").write_bytes(container.logs(timestamps=True))

    @_answered()
    def last_words(self, service: str) -> str | None:
        """The last line that a service logged before it ended; None if it still runs or logged nothing."""
        container = self._service(service)
        if container.status not in ("exited", "dead"):
            return None
        lines: list[str] = container.logs(tail=1).decode(errors="replace").split("\n")
        return lines[0].strip() or None

    @_answered()
    def stop(self, service: str, timeout_s: int = 20) -> None:
        """Stop one service and wait until it has ended."""
        for container in self._all():
            if container.labels[SERVICE_LABEL] == service:
                container.stop(timeout=timeout_s)

    def down(self) -> None:
        """End and remove everything of this project, whatever its profile and its fleet."""
        self._compose("down", "--timeout", "3", "--volumes", "--remove-orphans")
        with _answered():
            for network in self._client.networks.list(filters=OURS):
                network.remove()  # compose does not remove networks that this fleet does not have

    def images(self) -> dict[str, str]:
        """Image ids by name."""
        return {tag: container.image.id for container in self._all() for tag in container.image.tags}

    @_answered()
    def usage(self) -> dict[str, Usage]:
        """The resources that each service has used so far."""
        running = [container for container in self._all() if container.status == "running"]
        with ThreadPoolExecutor(len(running) or 1) as pool:  # the daemon takes a second per container
            used = list(pool.map(lambda container: usage_of(container.stats(stream=False, one_shot=True)), running))
        return {container.labels[SERVICE_LABEL]: each for container, each in zip(running, used, strict=True)}

    @_answered()
    def versions(self) -> dict[str, str]:
        """The versions of Docker, compose and the kernel."""
        info = self._client.version()
        asked = [*compose_command(), "version", "--short"]
        compose = subprocess.run(asked, capture_output=True, text=True, check=False)
        return {"docker": info["Version"], "compose": compose.stdout.strip(), "kernel": info["KernelVersion"]}

    @_answered()
    def _all(self) -> list[Any]:
        return list(self._client.containers.list(all=True, filters=OURS))

    def _service(self, service: str) -> Any:
        for container in self._all():
            if container.labels[SERVICE_LABEL] == service:
                return container
        raise DockerError(f"no container of service {service} runs")

    @_answered()
    def _unhealthy(self, healthy: set[str]) -> list[Any]:
        """The containers that are not healthy yet; adds the ids of those that have become so to `healthy`."""
        found = self._all()
        if not found:
            raise DockerError("compose started no container")
        asked = [container for container in found if container.id not in healthy]
        with ThreadPoolExecutor(len(asked) or 1) as pool:
            healthy |= {c.id for c, answer in zip(asked, pool.map(is_healthy, asked), strict=True) if answer}
        return [container for container in asked if container.id not in healthy]

    def _describe(self, container: Any, what: str) -> str:
        tail = container.logs(tail=LOG_LINES).decode(errors="replace").strip()
        said = "\n    ".join(tail.splitlines()) or "(it logged nothing)"
        return f"{container.labels[SERVICE_LABEL]} {what}; its last log lines:\n    {said}"

    def _compose(self, *words: str) -> None:
        # Another profile's fleet may have been left running.
        profiles = (*PROTOCOLS, *SENSOR_PROFILES) if words[0] == "down" else self._profiles
        options = ["--project-name", PROJECT]
        options += [word for path in self._files for word in ("--file", str(path))]
        options += [word for profile in profiles for word in ("--profile", profile)]
        command = [*compose_command(), *options, *words]
        failure = FleetError if words[0] == "up" else DockerError
        try:
            code, said = _run(command, self._environment, self._compose_limit_s)
        except subprocess.TimeoutExpired as error:
            raise failure(f"compose {words[0]}: did not end within {error.timeout:g} s") from error
        if code != 0:
            if "verlap" in said:
                raise DockerError(
                    "a network within 198.18.0.0/15 is in use by another Docker network; `make down` ends a fleet that "
                    "was left, `docker network ls` shows the others"
                )
            reasons = [line for line in said.splitlines() if "error" in line.lower()] or said.splitlines()
            raise failure(f"compose {words[0]}: {' '.join(reasons[-2:]) or 'failed without a word'}")


def connect_docker(address: str | None = None) -> docker.DockerClient:
    """Connect to this machine's Docker, or to that at an address. Raises DockerError if it does not answer."""
    try:
        client = docker.from_env() if address is None else docker.DockerClient(address, timeout=ANSWER_S)
        client.ping()
    except NO_ANSWER as error:
        what_to_do = "; type: make doctor" if address is None else ""
        raise DockerError(f"Docker does not answer: {error}{what_to_do}") from error
    return client


def start_network(containers: Containers, nodes: Sequence[str]) -> None:
    """Start the network and its nodes, without programs on the nodes.

    Raises TestbedError if the links cannot be shaped, so that nothing can be flown.
    """
    try:
        containers.start("net", *nodes)
    except ContainerDied as error:
        said = containers.last_words("net")
        if said is None:
            raise
        raise TestbedError(f"the links cannot be shaped: {said}") from error


def services_of(profiles: tuple[str, ...], path: Path = COMPOSE_FILE) -> list[str]:
    """The services that profiles start. Raises UserError if the file is no compose file."""
    services = read_services(path).items()
    return [name for name, service in services if set(profiles) & set(service.get("profiles", profiles))]


def _run(command: Sequence[str], environment: Mapping[str, str], limit_s: float | None) -> tuple[int, str]:
    """Run a command; returns its exit code and stderr.

    Raises subprocess.TimeoutExpired. On any error all processes that the command started are killed.
    """
    process = subprocess.Popen(
        command,
        cwd=ROOT,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        errors="replace",
        start_new_session=True,  # so that a second Ctrl-C does not reach the command that removes the fleet
    )
    with process:
        try:
            _, said = process.communicate(timeout=limit_s)
        except BaseException:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            raise
    return process.returncode, said


def compose_command() -> list[str]:
    """`docker compose` if installed, else docker-compose. Raises DockerError without either."""
    probe = ["docker", "compose", "version"]
    if shutil.which("docker") and subprocess.run(probe, capture_output=True, check=False).returncode == 0:
        return ["docker", "compose"]
    if shutil.which("docker-compose"):
        return ["docker-compose"]
    raise DockerError("neither `docker compose` nor docker-compose is installed; type: make doctor")


def _read_lines(chunks: Iterator[bytes], lines: Queue[str | None]) -> None:
    """Split a stream into lines; puts None at its end, also if it breaks."""
    rest = b""
    try:
        for chunk in chunks:
            *whole, rest = (rest + chunk).split(b"\n")
            for line in whole:
                lines.put(line.decode(errors="replace"))
        if rest:
            lines.put(rest.decode(errors="replace"))
    finally:
        lines.put(None)
