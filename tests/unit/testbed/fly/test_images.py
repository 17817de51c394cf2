"""A real autopilot that comes in an image, with a Docker that is made up."""

from __future__ import annotations

import io
import tarfile
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from docker.errors import ImageNotFound

from testbed.errors import DockerError, UserError
from testbed.fly import images
from testbed.fly.images import autopilot_in_image
from tests.handmade.autopilot_folders import make_folder

SETTINGS = {"AUTOPILOT": "px4", "AUTOPILOT_IMAGE": "mine:1"}


class Docker:
    """A client that has an image with a folder in /opt, and notes what was asked of it."""

    def __init__(self, folder: Path | None, *, is_here: bool = True) -> None:
        self.did: list[str] = []
        self._folder, self._is_here = folder, is_here
        self.images = SimpleNamespace(get=self._get, pull=self._pull)
        self.containers = SimpleNamespace(create=self._create)

    def _get(self, name: str) -> Any:
        if not self._is_here:
            raise ImageNotFound(f"no {name}")
        return SimpleNamespace(id="sha256:0123456789abcdef")

    def _pull(self, name: str) -> Any:
        self.did.append(f"pull {name}")
        if self._folder is None:
            raise ImageNotFound(f"nobody has {name}")
        self._is_here = True
        return self._get(name)

    def _create(self, *_: object, **__: object) -> Any:
        self.did.append("create")
        return SimpleNamespace(get_archive=self._archive, remove=lambda: self.did.append("remove"))

    def _archive(self, path: str) -> tuple[Iterator[bytes], dict[str, str]]:
        assert self._folder is not None
        packed = io.BytesIO()
        with tarfile.open(fileobj=packed, mode="w") as archive:
            archive.add(self._folder, arcname=Path(path).name)
        return iter([packed.getvalue()[:700], packed.getvalue()[700:]]), {}


@pytest.fixture(autouse=True)
def copies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(images, "COPIES", tmp_path / "copies")
    return tmp_path / "copies"


def test_it_is_copied_out_once(tmp_path: Path, copies: Path) -> None:
    client = Docker(make_folder(tmp_path / "px4"))
    folder = copies / "0123456789ab" / "px4"
    assert (
        autopilot_in_image(client, SETTINGS) == autopilot_in_image(client, SETTINGS) == {"AUTOPILOT_DIR": str(folder)}
    )
    assert client.did == ["create", "remove"]
    assert (folder / "bin" / "px4").read_bytes() == (tmp_path / "px4" / "bin" / "px4").read_bytes()


def test_an_image_that_is_not_here_is_pulled(tmp_path: Path) -> None:
    client = Docker(make_folder(tmp_path / "px4"), is_here=False)
    autopilot_in_image(client, SETTINGS)
    assert client.did[0] == "pull mine:1"


def test_one_that_nobody_has_is_said_with_the_way_out() -> None:
    with pytest.raises(DockerError, match=r"^PX4_IMAGE=mine:1: nobody has mine:1; or PX4_DIR=FOLDER$"):
        autopilot_in_image(Docker(None, is_here=False), SETTINGS)


def test_an_image_without_such_an_autopilot_is_said(tmp_path: Path) -> None:
    folder = make_folder(tmp_path / "px4")
    (folder / "bin" / "px4").unlink()
    with pytest.raises(UserError, match=r"^PX4_IMAGE=mine:1: /opt/px4: no bin/px4"):
        autopilot_in_image(Docker(folder), SETTINGS)


def test_without_an_image_nothing_is_asked() -> None:
    assert autopilot_in_image(Docker(None), {"AUTOPILOT": "px4", "AUTOPILOT_DIR": "/srv/px4"}) == {}
