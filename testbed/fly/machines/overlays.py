"""The overlays between `net` and the nodes on other machines, and each machine's carrier.

A worker of a swarm knows an overlay only once one of its containers is attached to it. The carrier is that container:
it sleeps at all overlays of its machine, and has the machine's volumes, so that files can be put there and fetched.
"""

from __future__ import annotations

import contextlib
import io
import tarfile
import tempfile
import time
from collections.abc import Mapping, Sequence
from ipaddress import IPv4Network
from pathlib import Path, PurePosixPath
from typing import Any

from docker.errors import APIError, NotFound
from docker.types import IPAMConfig, IPAMPool

from ...errors import DockerError
from ...plan.compose import PROJECT
from ...plan.fleet import Fleet
from ...plan.machines import overlay_of, volume_of
from .reach import Daemon, does, in_a_line
from .swarm import LABEL

CARRIER = f"{PROJECT}-carrier"
RUN_DIR, ROUTERS = "/run-dir", "/run/routers"
VOLUMES = {"live": RUN_DIR, "fleet": "/run/fleet", "routers": ROUTERS}
"""compose.yaml's volumes, and where containers have them."""
MTU = 1550
"""Docker takes VXLAN's 50 bytes off: nodes have 1,500, as those on this machine."""
GONE_S, POLL_S = 30.0, 0.2
NOT_ROOT = "1000:1000"
OURS = {"label": LABEL}
TAR_END = bytes(1024)
"""Without it tarfile takes what came of a file for the whole."""


def make_overlays(here: Any, fleet: Fleet, nodes: Sequence[str]) -> None:
    """One for each node. What Docker takes for itself is in the upper half: `net` and the nodes are in the lower."""
    for node in nodes:
        network = fleet.network(node)
        upper = list(network.subnets(prefixlen_diff=1))[1]
        pool = IPAMPool(str(network), iprange=str(upper), gateway=_gateway(network))
        with does("this machine", f"network {overlay_of(node)} cannot be made"):
            here.networks.create(
                overlay_of(node),
                driver="overlay",
                attachable=True,
                internal=True,  # else docker_gwbridge would be a way past `net`
                labels={LABEL: node},
                options={"com.docker.network.driver.mtu": str(MTU)},
                ipam=IPAMConfig(pool_configs=[pool]),
            )


def _gateway(network: IPv4Network) -> str:
    return str(network[1])


def remove_overlays(here: Any) -> None:
    """All of them, as soon as no container that is ending is attached any more."""
    deadline_s = time.monotonic() + GONE_S
    while overlays := here.networks.list(filters=OURS):
        if time.monotonic() > deadline_s + GONE_S:
            raise DockerError(f"network {overlays[0].name} is not gone {2 * GONE_S:g} s after it was first removed")
        for overlay in overlays:
            try:
                overlay.remove()
            except NotFound:
                continue
            except APIError as error:
                if time.monotonic() > deadline_s:
                    raise DockerError(f"network {overlay.name} cannot be removed: {error.explanation}") from error
        time.sleep(POLL_S)


class Carrier:
    """The placeholder on a machine."""

    def __init__(self, daemon: Daemon) -> None:
        self._daemon = daemon

    def start(self, image: str, volumes: Mapping[str, Mapping[str, str]]) -> None:
        """Attach it to every overlay of its machine. Raises DockerError naming the machine."""
        client = self._daemon.client
        first, *others = (overlay_of(node) for node in self._daemon.machine.nodes)
        with does(self._daemon.name, "its carrier cannot be attached"):
            for name, options in volumes.items():
                client.volumes.create(volume_of(name), driver_opts=dict(options), labels={LABEL: name})
            carrier = client.containers.create(
                image,
                ["sleep", "infinity"],
                name=CARRIER,
                labels={LABEL: "carrier"},
                init=True,
                network=first,
                cap_drop=["ALL"],
                cap_add=["SETUID", "SETGID", "SETPCAP"],
                volumes={volume_of(name): {"bind": VOLUMES[name]} for name in volumes},
            )
            carrier.start()
            for overlay in others:
                client.api.connect_container_to_network(carrier.id, overlay)

    def put(self, path: Path) -> None:
        """A file of this machine into the run folder there."""
        whole = io.BytesIO()
        with tarfile.open(fileobj=whole, mode="w") as archive:
            archive.add(path, path.name)
        with does(self._daemon.name, f"{path.name} cannot be put there"):
            self._container().put_archive(RUN_DIR, whole.getvalue())

    def touch(self, path: str) -> None:
        """Make an empty file there."""
        with does(self._daemon.name, f"{path} cannot be made there"):
            self._container().exec_run(["touch", path], user=NOT_ROOT)

    def fetch(self, name: str, folder: Path) -> None:
        """A folder in the run folder there into one of this machine: its files, and nothing that lies beside it.

        Raises DockerError naming the machine where it is not there, or does not come whole.
        """
        failure = f"{name} cannot be fetched"
        with tempfile.TemporaryFile() as whole:
            with does(self._daemon.name, failure):
                chunks, _ = self._container().get_archive(f"{RUN_DIR}/{name}")
                whole.writelines(chunks)
                whole.seek(-min(whole.tell(), len(TAR_END)), io.SEEK_END)
                is_whole = whole.read() == TAR_END
            if not is_whole:
                raise DockerError(f"{self._daemon.name}: {failure}: it came in part")
            whole.seek(0)
            try:
                with tarfile.open(fileobj=whole) as archive:
                    files = [member for member in archive.getmembers() if member.isfile()]
                    if odd := [member.name for member in files if not _is_below(member.name, name)]:
                        raise DockerError(f"{self._daemon.name}: {failure}: {odd[0]!r} is not in it")
                    archive.extractall(folder, members=files, filter="data")
            except (tarfile.TarError, EOFError) as error:
                raise DockerError(f"{self._daemon.name}: {failure}: {in_a_line(error)}") from error

    def remove(self) -> None:
        """It and its volumes; nothing where there is none."""
        client = self._daemon.client
        with does(self._daemon.name, "its carrier cannot be removed"):
            with contextlib.suppress(NotFound):
                client.containers.get(CARRIER).remove(force=True)
            for volume in client.volumes.list(filters=OURS):
                volume.remove()

    def _container(self) -> Any:
        return self._daemon.client.containers.get(CARRIER)


def _is_below(path: str, folder: str) -> bool:
    parts = PurePosixPath(path).parts
    return parts[:1] == (folder,) and ".." not in parts
