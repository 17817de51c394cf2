"""A machine that does not fit is one line; the node image goes where it is missing, and only there."""

from __future__ import annotations

import io
import socket
import tarfile
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from docker.errors import APIError, ImageNotFound
from urllib3.exceptions import ProtocolError

from testbed.errors import DockerError, UserError
from testbed.fly import containers
from testbed.fly.machines import reach
from testbed.fly.machines.overlays import Carrier
from testbed.fly.machines.reach import Daemon
from testbed.plan.machines import Machine

IMAGE = "node:latest"


class _Docker:
    """A daemon as it describes itself, with the id of its node image; None: it has none."""

    def __init__(self, name: str = "here", image: str | None = "sha256:1", **found: Any) -> None:
        told: dict[str, Any] = {"version": "20.10", "architecture": "amd64", "networks": ["bridge", "overlay"], **found}
        self.loaded: list[bytes] = []
        self.refuses = False
        self.said: list[dict[str, str] | Exception] = []
        """While an image is loaded."""
        self._name, self._image, self._told = name, image, told
        self.images = SimpleNamespace(get=self._get)
        self.api = SimpleNamespace(get_image=lambda _: [(image or "").encode()], load_image=self._load)

    def info(self) -> dict[str, Any]:
        return {
            **{"ID": "the same, as machines that were copied have it", "Name": self._name, "DockerRootDir": "/"},
            "Plugins": {"Network": self._told["networks"]},
        }

    def version(self) -> dict[str, str]:
        return {"Version": self._told["version"], "Arch": self._told["architecture"]}

    def _get(self, name: str) -> SimpleNamespace:
        if self._image is None:
            raise ImageNotFound(f"{name}: not there")
        return SimpleNamespace(id=self._image)

    def _load(self, chunks: list[bytes], quiet: bool) -> Iterator[dict[str, str]]:
        """As the client has it: a refusal comes once what is said is read."""
        assert not quiet, "else nothing comes until the end, which a slow machine has not within the time for an answer"
        if self.refuses:
            raise APIError("no space left on device")
        for one in self.said:
            if isinstance(one, Exception):
                raise one
            yield one
        self.loaded += chunks
        self._image = chunks[0].decode()


class OddDocker:
    """A daemon's socket. What a path that holds a key of `answers` is answered with; None: nothing, ever."""

    def __init__(self, folder: Path) -> None:
        self.answers: dict[str, bytes | None] = {}
        self.asked: list[tuple[str, str]] = []
        """Methods and paths."""
        self.address = f"unix://{folder}/s"
        self._listener = socket.socket(socket.AF_UNIX)
        self._listener.bind(f"{folder}/s")
        self._listener.listen()
        threading.Thread(target=self._serve, daemon=True).start()

    def close(self) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()

    def _serve(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            threading.Thread(target=self._talk, args=(connection,), daemon=True).start()

    def _talk(self, connection: socket.socket) -> None:
        with connection, connection.makefile("rb") as asked:
            while line := asked.readline():
                while asked.readline().strip():
                    pass
                method, path, _ = line.decode().split()
                self.asked.append((method, path))
                body = self._answer(path)
                if body is not None:
                    head = f"HTTP/1.1 200 OK\r\nApi-Version: 1.41\r\nContent-Length: {len(body)}\r\n\r\n".encode()
                    connection.sendall(body if body.endswith(b"\r\n") else head + body)

    def _answer(self, path: str) -> bytes | None:
        for part, answer in self.answers.items():
            if part in path:
                return answer
        return b'{"Version":"20.10","Arch":"amd64","ApiVersion":"1.41"}' if "version" in path else b"OK"


@pytest.fixture
def odd_docker(monkeypatch: pytest.MonkeyPatch) -> Iterator[OddDocker]:
    """Another machine's; this one's is as it should be."""
    here, connect = _Docker(), containers.connect_docker
    monkeypatch.setattr(here, "close", lambda: None, raising=False)
    monkeypatch.setattr(reach, "connect_docker", lambda address=None: here if address is None else connect(address))
    with tempfile.TemporaryDirectory(prefix="mx") as folder:  # short: a socket's path may have 107 bytes
        docker = OddDocker(Path(folder))
        yield docker
        docker.close()


def _daemons(*clients: _Docker) -> list[Daemon]:
    return [Daemon(Machine(f"ssh://{name}", ()), "", client) for name, client in zip("ab", clients, strict=False)]


def test_machines_that_are_alike_fit() -> None:
    reach._check(_Docker(), _daemons(_Docker("a"), _Docker("b")))


@pytest.mark.parametrize(
    ("second", "said"),
    [
        (_Docker("a"), "MACHINES: ssh://b: its Docker is that of ssh://a: expected each machine once"),
        (_Docker(), "MACHINES: ssh://b: its Docker is that of this machine: expected each machine once"),
        (_Docker("b", version="28.2"), "MACHINES: ssh://b: Docker's Version is 28.2: expected 20.10, as here"),
        (_Docker("b", architecture="arm64"), "MACHINES: ssh://b: Docker's Arch is arm64: expected amd64, as here"),
        (_Docker("b", networks=["bridge"]), "MACHINES: ssh://b: expected a Docker that has overlay networks"),
    ],
)
def test_a_machine_that_does_not_fit_is_named(second: _Docker, said: str) -> None:
    with pytest.raises(UserError) as error:
        reach._check(_Docker(), _daemons(_Docker("a"), second))
    assert str(error.value) == said


@pytest.mark.parametrize(("image", "loaded"), [("sha256:1", []), ("sha256:0", [b"sha256:1"]), (None, [b"sha256:1"])])
def test_the_image_is_loaded_where_it_is_missing_or_another(image: str | None, loaded: list[bytes]) -> None:
    there = _Docker("a", image)
    reach._bring_image(_Docker(), _daemons(there)[0], IMAGE)
    assert there.loaded == loaded


def test_an_image_that_is_nowhere_or_cannot_be_loaded_is_named() -> None:
    with pytest.raises(DockerError, match=r"^node:latest: not here; type: make containers$"):
        reach._bring_image(_Docker(image=None), _daemons(_Docker("a"))[0], IMAGE)
    there, full, lost = _Docker("a", None), _Docker("a", None), _Docker("a", None)
    there.refuses, full.said = True, [{"status": "Loading layer"}, {"error": "no space\nleft on device"}]
    for one in (there, full):
        with pytest.raises(DockerError, match=r"^a: node:latest could not be loaded: no space left on device$"):
            reach._bring_image(_Docker(), _daemons(one)[0], IMAGE)
        assert one.loaded == []
    lost.said = [ProtocolError("Connection broken: IncompleteRead")]
    with pytest.raises(DockerError, match=r"^a: node:latest could not be loaded: Connection broken: IncompleteRead$"):
        reach._bring_image(_Docker(), _daemons(lost)[0], IMAGE)


@pytest.mark.parametrize(
    ("path", "answer", "said"),
    [
        ("", None, "Docker does not answer: .*Read timed out"),
        ("_ping", None, "Docker does not answer: .*Read timed out"),
        ("_ping", b"\xff\xfe\r\n\r\n", "Docker does not answer: .*BadStatusLine"),
        ("version", b'{"ApiVersion":"x"}', "Docker does not answer: invalid literal"),
        ("info", None, "Docker does not say what it is: .*Read timed out"),
        ("info", b"[]", "Docker does not say what it is: "),
        ("info", b"{}", "Docker does not say what it is: 'ID'"),
        ("info", b'{"ID": "\xff', "Docker does not say what it is: "),
        ("info", b'{"ID":"1","Name":"b","DockerRootDir":"/","Plugins":null}', "Docker does not say what it is: "),
    ],
)
def test_a_docker_that_is_silent_or_says_no_answer_is_one_line_that_names_the_machine(
    path: str, answer: bytes | None, said: str, odd_docker: OddDocker, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(containers, "ANSWER_S", 0.2)
    odd_docker.answers[path] = answer
    machine = Machine(odd_docker.address, ())
    with (
        pytest.raises(UserError, match=rf"^MACHINES: {machine.address}: {said}") as error,
        reach.reached([machine], IMAGE),
    ):
        pass
    assert str(error.value).isprintable()


def test_a_fleet_that_somebody_flies_on_a_machine_is_left_in_peace() -> None:
    asked: list[dict[str, Any]] = []

    def containers_there(filters: dict[str, Any]) -> list[dict[str, str]]:
        asked.append(filters)
        return [{"Id": "1"}] if len(asked) == 2 else []

    a, b = _daemons(_Docker("a"), _Docker("b"))
    for daemon in (a, b):
        daemon.client.api.containers = containers_there
    with pytest.raises(UserError) as error:
        reach._refuse_flights([a, b])
    assert str(error.value) == "MACHINES: ssh://b: a fleet of its own runs there: expected none (make down, there)"
    assert asked[0] == {"label": ["com.docker.compose.project=mqttxt-testbed", "com.docker.compose.service=net"]}


def test_a_machine_that_is_refused_is_left_as_it_is(odd_docker: OddDocker) -> None:
    """With real requests: the fleet is found, and nothing is asked of the machine but what it is and has."""
    info = b'{"ID":"1","Name":"b","DockerRootDir":"/","Plugins":{"Network":["overlay"]}}'
    odd_docker.answers |= {"info": info, "containers": b'[{"Id":"1"}]'}
    machine = Machine(odd_docker.address, ())
    with pytest.raises(UserError, match="a fleet of its own runs there"), reach.reached([machine], IMAGE):
        pass
    assert {method for method, _ in odd_docker.asked} == {"GET"}


def _archive(*names: str) -> bytes:
    whole = io.BytesIO()
    with tarfile.open(fileobj=whole, mode="w") as archive:
        for name in names:
            member = tarfile.TarInfo(name)
            member.size = 1000
            archive.addfile(member, io.BytesIO(bytes([65]) * 1000))
    return whole.getvalue()


def _carrier(sent: bytes) -> Carrier:
    container = SimpleNamespace(get_archive=lambda _: ([sent], {}))
    client = SimpleNamespace(containers=SimpleNamespace(get=lambda _: container))
    return Carrier(Daemon(Machine("ssh://a", ()), "", client))


def test_a_folder_is_fetched(tmp_path: Path) -> None:
    _carrier(_archive("sitl/uav1/log", "sitl/uav2/log")).fetch("sitl", tmp_path)
    assert sorted(path.parent.name for path in tmp_path.glob("sitl/*/log")) == ["uav1", "uav2"]


@pytest.mark.parametrize("name", ["manifest.json", "../sitl/log", "sitl/../manifest.json", "/sitl/log", "sitlx/log"])
def test_nothing_but_the_folder_is_taken_from_another_machine(name: str, tmp_path: Path) -> None:
    run = tmp_path / "run"
    run.mkdir()
    with pytest.raises(DockerError, match=r"^a: sitl cannot be fetched: '.*' is not in it$"):
        _carrier(_archive("sitl/log", name)).fetch("sitl", run)
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


@pytest.mark.parametrize("length", [0, 100, 512, 1000, 1536, 2000, 2048, 3072, 3500])
def test_a_folder_that_comes_in_part_is_none(length: int, tmp_path: Path) -> None:
    sent = _archive("sitl/a", "sitl/b")[:length]
    with pytest.raises(DockerError, match=r"^a: sitl cannot be fetched: "):
        _carrier(sent).fetch("sitl", tmp_path)
    assert list(tmp_path.iterdir()) == []
