"""Only one fleet flies at a time."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from requests.exceptions import ConnectionError as RequestsConnectionError

from testbed.errors import ContainerDied, DockerError, FleetError
from testbed.fly import containers, daemon, only_run
from testbed.fly.containers import Containers, services_of
from testbed.fly.daemon import Usage, usage_of
from testbed.plan.sensors import SENSOR_PROFILES
from tests.rigs.loopback import wait_until


class _Exec:
    """What runs a command in a container; the command speaks every millisecond, or its stream breaks."""

    def __init__(self, lines: list[bytes], code: int | None) -> None:
        self._lines, self._code = lines, code

    def exec_create(self, *_: object, **__: object) -> dict[str, str]:
        return {"Id": "1"}

    def exec_start(self, *_: object, **__: object) -> Iterator[bytes]:
        for line in self._lines:
            time.sleep(0.001)
            yield line

    def exec_inspect(self, _: str) -> dict[str, int | None]:
        return {"ExitCode": self._code}


def _containers(
    monkeypatch: pytest.MonkeyPatch, lines: list[bytes], code: int | None
) -> tuple[Containers, list[float]]:
    fleet = Containers.__new__(Containers)
    looked: list[float] = []
    monkeypatch.setattr(fleet, "_client", SimpleNamespace(api=_Exec(lines, code)), raising=False)
    monkeypatch.setattr(fleet, "_service", lambda _: SimpleNamespace(id="1"))
    monkeypatch.setattr(fleet, "check_alive", lambda: looked.append(time.monotonic()))
    return fleet, looked


def test_a_command_that_speaks_often_does_not_hide_a_container_that_died(monkeypatch: pytest.MonkeyPatch) -> None:
    fleet, looked = _containers(monkeypatch, [b"a\nb", b"c\n"] * 50, 0)
    said = list(fleet.execute("gs", ["mission"], limit_s=60, alive_every_s=0.01))
    assert said == ["a", "bc"] * 50
    assert len(looked) > 3


def test_one_request_tells_whether_all_are_alive(monkeypatch: pytest.MonkeyPatch) -> None:
    """Docker's client asks after each container when it lists them; in flight that took cores from the nodes."""
    state, fleet = ["running"], Containers.__new__(Containers)
    ended = SimpleNamespace(
        attrs={"State": {"ExitCode": 137}}, labels={containers.SERVICE_LABEL: "uav2"}, logs=lambda tail: b"the last"
    )

    def listed(all: bool, filters: dict[str, str]) -> list[dict[str, str]]:
        assert (all, filters) == (True, {"label": "com.docker.compose.project=mqttxt-testbed"})
        return [{"Id": "1", "State": "running"}, {"Id": "2", "State": state[0]}]

    client = SimpleNamespace(api=SimpleNamespace(containers=listed))
    monkeypatch.setattr(fleet, "_client", client, raising=False)
    fleet.check_alive()
    state[0] = "exited"
    client.containers = SimpleNamespace(get={"2": ended}.__getitem__)
    with pytest.raises(ContainerDied, match=r"uav2 ended with exit code 137(.|\n)*the last"):
        fleet.check_alive()


def test_a_command_that_Docker_lost_sight_of_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    fleet, _ = _containers(monkeypatch, [b"a\n"], None)
    with pytest.raises(DockerError, match="gs: lost touch with mission, which still runs"):
        list(fleet.execute("gs", ["mission"], limit_s=60))


@pytest.mark.parametrize(
    ("asked", "words", "status"),
    [
        ("output", ("gs", ["true"]), "running"),
        ("stop", ("gs",), "running"),
        ("save_logs", (Path("logs"),), "running"),
        ("usage", (), "running"),
        ("last_words", ("gs",), "exited"),
        ("versions", (), "running"),
        ("start", (), "running"),
    ],
)
def test_a_docker_that_is_lost_within_a_request_is_a_docker_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, asked: str, words: tuple[object, ...], status: str
) -> None:
    """The client's own error is an OSError, which would end the run as a full disk does."""

    def lost(*_: object, **__: object) -> None:
        raise RequestsConnectionError("Connection aborted.")

    container = SimpleNamespace(
        **dict.fromkeys(("exec_run", "stop", "logs", "stats"), lost),
        id="1",
        labels={containers.SERVICE_LABEL: "gs"},
        status=status,
        attrs={"State": {"Health": {"Status": "starting"}}, "Config": {"Healthcheck": {"Test": ["CMD", "true"]}}},
    )
    client = SimpleNamespace(containers=SimpleNamespace(list=lambda **_: [container]), version=lost)
    fleet = Containers.__new__(Containers)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(fleet, "_client", client, raising=False)
    monkeypatch.setattr(fleet, "_timeout_s", 1.0, raising=False)
    monkeypatch.setattr(fleet, "up", lambda *_: None)
    with pytest.raises(DockerError, match=r"^Docker does not answer: Connection aborted\.$"):
        getattr(fleet, asked)(*words)


def test_a_docker_that_is_lost_as_a_command_begins_is_a_docker_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def lost(*_: object, **__: object) -> None:
        raise RequestsConnectionError("Connection aborted.")

    fleet, _ = _containers(monkeypatch, [], 0)
    monkeypatch.setattr(_Exec, "exec_create", lost)
    with pytest.raises(DockerError, match=r"^Docker does not answer: Connection aborted\.$"):
        list(fleet.execute("gs", ["mission"], limit_s=60))


def test_a_command_that_hangs_fails_the_attempt(monkeypatch: pytest.MonkeyPatch) -> None:
    fleet, _ = _containers(monkeypatch, [b"a\n"] * 1000, 0)
    with pytest.raises(FleetError, match=r"gs: mission did not end within 0\.05 s"):
        list(fleet.execute("gs", ["mission"], limit_s=0.05))


def test_what_a_profile_starts_is_read_from_the_compose_file(tmp_path: Path) -> None:
    compose = tmp_path / "compose.yaml"
    compose.write_text(
        "x-node: &node {profiles: [mqttxt, mavlink]}\n"
        "services:\n"
        "  net: {image: node}\n"
        "  gs: {<<: *node}\n"
        "  broker: {profiles: [mqttxt]}\n"
        "  router-gs: {profiles: [mavlink]}\n"
    )
    assert services_of(("mqttxt",), compose) == ["net", "gs", "broker"]
    assert services_of(("mavlink",), compose) == ["net", "gs", "router-gs"]
    assert services_of(("mavlink", "mqttxt"), compose) == ["net", "gs", "broker", "router-gs"]


class _Networks:
    """Networks that compose left; `removed` are those that were removed after all."""

    def __init__(self) -> None:
        self.removed: list[str] = []

    def list(self, filters: dict[str, str]) -> list[SimpleNamespace]:
        assert filters == {"label": "com.docker.compose.project=mqttxt-testbed"}
        return [SimpleNamespace(remove=lambda: self.removed.append("uav12"))]


@pytest.fixture
def composed(monkeypatch: pytest.MonkeyPatch) -> tuple[Containers, list[list[str]]]:
    """MAVLink's containers, whose compose only writes down what it is asked, and cannot start anything."""
    fleet = Containers.__new__(Containers)
    monkeypatch.setattr(fleet, "_profiles", ("mavlink",), raising=False)
    monkeypatch.setattr(fleet, "_environment", {}, raising=False)
    monkeypatch.setattr(fleet, "_timeout_s", 1.0, raising=False)
    monkeypatch.setattr(fleet, "_client", SimpleNamespace(networks=_Networks()), raising=False)
    monkeypatch.setattr(fleet, "_files", [containers.COMPOSE_FILE], raising=False)
    monkeypatch.setattr(containers, "compose_command", lambda: ["compose"])
    ran: list[list[str]] = []

    def run(command: list[str], *_: object) -> tuple[int, str]:
        ran.append(command)
        return int("up" in command), "Creating router-gs\nERROR: for sitl1  Container 0a1b is unhealthy.\n"

    monkeypatch.setattr(fleet, "_compose_limit_s", None, raising=False)
    monkeypatch.setattr(containers, "_run", run)
    return fleet, ran


def test_a_fleet_is_taken_down_whatever_protocol_it_was_for(composed: tuple[Containers, list[list[str]]]) -> None:
    fleet, ran = composed
    fleet.down()
    assert [after for word, after in pairwise(ran[0]) if word == "--profile"] == ["mqttxt", "mavlink", *SENSOR_PROFILES]


def test_networks_of_a_larger_fleet_are_removed_with_the_fleet(composed: tuple[Containers, list[list[str]]]) -> None:
    fleet, _ = composed
    networks: Any = fleet._client.networks
    fleet.down()
    assert networks.removed == ["uav12"]


def test_a_start_that_compose_gives_up_is_the_fleets_own_failure(
    composed: tuple[Containers, list[list[str]]],
) -> None:
    fleet, ran = composed
    with pytest.raises(FleetError, match="compose up: ERROR: for sitl1  Container 0a1b is unhealthy"):
        fleet.start()
    assert [after for word, after in pairwise(ran[-1]) if word == "--profile"] == ["mavlink"]


@pytest.mark.long
def test_compose_does_not_wait_for_another_machine_for_ever_and_nothing_of_it_goes_on(
    composed: tuple[Containers, list[list[str]]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fleet, _ = composed
    monkeypatch.undo()
    started = tmp_path / "started"
    for name, value in {"_profiles": (), "_environment": {}, "_files": [], "_compose_limit_s": 2.0}.items():
        monkeypatch.setattr(fleet, name, value, raising=False)
    script = f"sleep 60 & echo $! > {started}; wait"
    monkeypatch.setattr(containers, "compose_command", lambda: ["/bin/sh", "-c", script])
    with pytest.raises(DockerError, match=r"^compose down: did not end within 2 s$"):
        fleet.down()
    wait_until(lambda: _has_ended(int(started.read_text())), "what compose has started ends")


def _has_ended(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().split()[2] == "Z"
    except (FileNotFoundError, ProcessLookupError):
        return True


def test_a_second_run_is_told_who_flies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(only_run, "LOCK", tmp_path / "lock")
    program = (
        "import sys, pathlib; from testbed.fly import only_run; only_run.LOCK = pathlib.Path(sys.argv[1]);"
        "only_run.only_run(); print('flying', flush=True); sys.stdin.read()"
    )
    command = [sys.executable, "-c", program, str(tmp_path / "lock")]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as first:
        assert first.stdout is not None
        assert first.stdin is not None
        assert first.stdout.readline() == "flying\n"
        with pytest.raises(DockerError, match=rf"another run is going on \(process {first.pid}\)"):
            only_run.only_run()
        first.stdin.close()
    only_run.only_run()


@pytest.mark.parametrize(
    ("memory", "used"),
    [
        ({"usage": 5000, "stats": {"inactive_file": 1000}}, 4000),
        ({"usage": 5000, "stats": {"total_inactive_file": 2000, "inactive_file": 1000}}, 3000),
        ({"usage": 5000}, 5000),
        ({}, None),
    ],
)
def test_memory_is_counted_without_pages_that_can_be_had_back(memory: dict[str, Any], used: int | None) -> None:
    stats = {"cpu_stats": {"cpu_usage": {"total_usage": 1_234_567_890}}, "memory_stats": memory}
    assert usage_of(stats) == Usage(1.23, used)


class _Tested:
    """A container with a health test that ends with an exit code; `ran` is what was run in it."""

    def __init__(self, health: str | None, test: list[str], exit_code: int = 0, status: str = "running") -> None:
        self.status = status
        state = {} if health is None else {"Health": {"Status": health}}
        self.attrs = {"State": state, "Config": {"Healthcheck": {"Test": test}}}
        self.ran: list[list[str]] = []
        self._exit_code = exit_code

    def exec_run(self, words: list[str]) -> SimpleNamespace:
        self.ran.append(words)
        return SimpleNamespace(exit_code=self._exit_code)


@pytest.mark.parametrize(("exit_code", "expected"), [(0, True), (1, False)])
def test_a_container_that_Docker_has_not_looked_at_is_asked_itself(exit_code: int, expected: bool) -> None:
    asked = _Tested("starting", ["CMD", "test", "-e", "/run/ready"], exit_code)
    in_a_shell = _Tested("starting", ["CMD-SHELL", "test -e /run/ready"], exit_code)
    assert [daemon.is_healthy(asked), daemon.is_healthy(in_a_shell)] == [expected, expected]
    assert [asked.ran, in_a_shell.ran] == [[["test", "-e", "/run/ready"]], [["sh", "-c", "test -e /run/ready"]]]


def test_a_container_that_Docker_has_looked_at_or_that_ended_is_not_asked() -> None:
    known = [_Tested(None, []), _Tested("healthy", []), _Tested("unhealthy", []), _Tested("starting", [], 0, "exited")]
    assert [daemon.is_healthy(container) for container in known] == [True, True, False, False]
    assert not any(container.ran for container in known)


def test_the_emulator_may_use_as_much_real_time_as_dockers_containers_have(tmp_path: Path) -> None:
    given = tmp_path / "cpu.rt_runtime_us"
    assert daemon.real_time_us(given) == 0
    given.write_text("900000\n")
    assert daemon.real_time_us(given) == 900_000
