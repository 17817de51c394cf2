"""Real autopilots from Docker images: copies the needed folder out of an image, once."""

from __future__ import annotations

import shutil
import tarfile
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from docker.errors import APIError, ImageNotFound
from requests.exceptions import RequestException

from ..errors import DockerError
from ..plan.autopilots import DIR, IMAGE, KINDS
from ..plan.documents import ROOT

COPIES = ROOT / ".cache" / "autopilots"
"""The copies, by the images' ids."""


def autopilot_in_image(client: Any, settings: Mapping[str, str]) -> dict[str, str]:
    """The setting for the folder of an autopilot that settings name by an image; empty if they name none.

    Raises DockerError if the image is not available, UserError if it has no such autopilot for this machine.
    """
    name = settings.get(IMAGE)
    if name is None:
        return {}
    kind = KINDS[settings["AUTOPILOT"]]
    try:
        image = _image(client, name)
        copy = COPIES / str(image.id).rpartition(":")[2][:12]
        if not copy.is_dir():
            _copy_out(client, image, kind.folder_in_image, copy)
    except (APIError, ImageNotFound, RequestException) as error:
        raise DockerError(f"{kind.image_variable}={name}: {error}; or {kind.folder_variable}=FOLDER") from error
    folder = copy / Path(kind.folder_in_image).name
    kind.check(folder, f"{kind.image_variable}={name}: {kind.folder_in_image}")
    return {DIR: str(folder)}


def _image(client: Any, name: str) -> Any:
    try:
        return client.images.get(name)
    except ImageNotFound:
        return client.images.pull(name)


def _copy_out(client: Any, image: Any, path: str, copy: Path) -> None:
    """Copy a folder of an image, completely or not at all."""
    fresh = copy.with_suffix(".new")
    shutil.rmtree(fresh, ignore_errors=True)
    fresh.mkdir(parents=True)
    container = client.containers.create(image, command="true")
    try:
        chunks, _ = container.get_archive(path)
        with tempfile.TemporaryFile() as archive:
            archive.writelines(chunks)
            archive.seek(0)
            with tarfile.open(fileobj=archive) as members:
                members.extractall(fresh, filter="data")
    finally:
        container.remove()
    fresh.rename(copy)
