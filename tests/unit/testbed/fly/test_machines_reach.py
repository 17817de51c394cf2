"""A machine that does not fit is one line; the node image goes where it is missing, and only there."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from docker.errors import APIError, ImageNotFound

from testbed.errors import DockerError, UserError
from testbed.fly.machines import reach
from testbed.fly.machines.reach import Daemon
from testbed.plan.machines import Machine

IMAGE = "node:latest"


class _Docker:
    """A daemon as it describes itself, with the id of its node image; None: it has none."""

    def __init__(self, name: str = "here", image: str | None = "sha256:1", **found: Any) -> None:
        told: dict[str, Any] = {"version": "20.10", "architecture": "amd64", "networks": ["bridge", "overlay"], **found}
        self.loaded: list[bytes] = []
        self.refuses = False
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

    def _load(self, chunks: list[bytes]) -> None:
        if self.refuses:
            raise APIError("no space left on device")
        self.loaded += chunks
        self._image = chunks[0].decode()


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
    there = _Docker("a", None)
    there.refuses = True
    with pytest.raises(DockerError, match=r"^a: node:latest could not be loaded: no space left on device$"):
        reach._bring_image(_Docker(), _daemons(there)[0], IMAGE)
