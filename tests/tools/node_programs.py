"""The nodes' Mosquitto and mavp2p as programs of this machine, copied out of the node image with their libraries: a
test starts one in the time in which a container would only be made, and both are of one version.
"""

from __future__ import annotations

import io
import shutil
import subprocess
import tarfile
from pathlib import Path

from testbed.bootstrap.images import NODE, node_inputs
from testbed.bootstrap.steps import CACHE, BootstrapError, step

FOLDER = CACHE / "node-programs"
MOSQUITTO, MAVP2P = FOLDER / "bin" / "mosquitto", FOLDER / "bin" / "mavp2p"
_OF = FOLDER / "node-image"
"""What the node image was made from that they are of."""
_PACK = 'tar -ch $(ldd "$(which mosquitto)" | grep -o "/[^ ]*") "$(which mosquitto)" "$(which mavp2p)"'
_START = """\
#!/bin/sh
exec {loader} --library-path {libraries} --argv0 mosquitto {program} "$@"
"""


def node_programs_are_current() -> bool:
    return _OF.exists() and _OF.read_text() == node_inputs()


def ensure_node_programs() -> None:
    """Make sure that they are there, and of the node image as it is now."""
    if node_programs_are_current():
        return
    with step("copying Mosquitto and mavp2p out of the node image"):
        shutil.rmtree(FOLDER, ignore_errors=True)
        files = FOLDER / "files"
        files.mkdir(parents=True)
        MOSQUITTO.parent.mkdir()
        with tarfile.open(fileobj=io.BytesIO(_packed())) as archive:
            for member in archive.getmembers():
                content = archive.extractfile(member)
                assert content is not None, member.name
                (files / Path(member.name).name).write_bytes(content.read())
        (loader,) = files.glob("ld-linux*")
        MOSQUITTO.write_text(_START.format(loader=loader, libraries=files, program=files / "mosquitto"))
        (files / "mavp2p").rename(MAVP2P)
        for program in (loader, files / "mosquitto", MOSQUITTO, MAVP2P):
            program.chmod(0o755)
        _OF.write_text(node_inputs())


def _packed() -> bytes:
    command = ["docker", "run", "--rm", "--entrypoint", "sh", NODE, "-c", _PACK]
    done = subprocess.run(command, capture_output=True, check=False)
    if done.returncode != 0:
        raise BootstrapError(f"{NODE}: {done.stderr.decode(errors='replace').strip()}")
    return done.stdout
