"""A `mosquitto` for commands that a test types: the machine's own, else that of the testbed's image."""

from __future__ import annotations

import shutil
from pathlib import Path

import docker
import docker.errors

from mqttxt.core import mosquitto
from tests.rigs.processes import NODE_IMAGE

IN_CONTAINER = """\
#!/bin/sh
exec docker run --rm --init --label {label} --network host --user 1000:1000 --volume "$TMPDIR:$TMPDIR:ro" \\
    --entrypoint mosquitto {image} "$@"
"""
BEING_REMOVED = (404, 409)
"""Docker's status codes for a container that `--rm` has removed, or is removing, in the meantime."""


class MosquittoProgram:
    """`mosquitto` in a folder that goes on the PATH; it reads files in TMPDIR. `label` is the test's own."""

    def __init__(self, folder: Path, label: str) -> None:
        self._label = label
        own = mosquitto.find()
        path = folder / "mosquitto"
        if own is not None:
            path.symlink_to(own)
        else:
            assert shutil.which("docker") is not None
            path.write_text(IN_CONTAINER.format(label=label, image=NODE_IMAGE))
            path.chmod(0o755)
        self._is_contained = own is None

    def close(self) -> None:
        """End what a killed process has left."""
        if self._is_contained:
            for left in docker.from_env().containers.list(filters={"label": self._label}, ignore_removed=True):
                try:
                    left.remove(force=True)
                except docker.errors.APIError as error:
                    if error.status_code not in BEING_REMOVED:
                        raise
