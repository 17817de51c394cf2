"""Several machines simulated on one: Docker daemons in network namespaces of their own, joined by a bridge."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Self

import docker

from testbed.bootstrap.images import NODE
from tests.rigs.processes import wait_until

SUBNET = "10.231.7"
STARTED_S, ENDED_S = 60.0, 60.0


class DockerMachine:
    """A daemon whose only network is a cable to the bridge; `log` has its output."""

    def __init__(self, folder: Path, bridge: str, number: int) -> None:
        self.folder = folder
        self.log = folder / "dockerd.log"
        self._namespace, self._cable = f"{bridge}-{number}", f"{bridge}v{number}"
        self._bridge, self._ip = bridge, f"{SUBNET}.{number}"
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def address(self) -> str:
        return f"unix://{self.folder}/docker.sock"

    @property
    def name(self) -> str:
        """The machine's name in the testbed."""
        return self.address.partition("://")[2]

    def client(self) -> Any:
        return docker.DockerClient(self.address)

    def start(self) -> None:
        self.folder.mkdir()
        _run("ip", "netns", "add", self._namespace)
        _run("ip", "link", "add", self._cable, "type", "veth", "peer", "name", "eth0", "netns", self._namespace)
        _run("ip", "link", "set", self._cable, "master", self._bridge, "up")
        for words in (f"addr add {self._ip}/24 dev eth0", "link set eth0 up", "link set lo up"):
            _run("ip", "-netns", self._namespace, *words.split())
        # `ip netns exec` would hide the cgroups.
        command = ["nsenter", f"--net=/run/netns/{self._namespace}", "dockerd", "--host", self.address]
        for option, name in {"data-root": "data", "exec-root": "run", "pidfile": "pid"}.items():
            command += [f"--{option}", str(self.folder / name)]
        with self.log.open("wb") as log:
            self._process = subprocess.Popen(command, stdout=log, stderr=log, start_new_session=True)
        wait_until(self._answers, f"a daemon answers ({self.log})", STARTED_S)

    def kill(self) -> None:
        """Simulate a power cut: nothing of it runs or can be reached any more."""
        with contextlib.closing(self.client()) as client:
            first = [client.api.inspect_container(one.id)["State"]["Pid"] for one in client.containers.list()]
        _run("ip", "link", "del", self._cable)
        for process in (*self._own_processes(), *first):
            with contextlib.suppress(ProcessLookupError):
                os.kill(process, signal.SIGKILL)
        assert self._process is not None
        self._process.wait(ENDED_S)

    def close(self) -> None:
        """End it, and leave nothing behind."""
        if self._process is not None:
            self._process.terminate()
            self._process.wait(ENDED_S)
        for process in self._own_processes():
            with contextlib.suppress(ProcessLookupError):
                os.kill(process, signal.SIGKILL)
        subprocess.run(["ip", "link", "del", self._cable], check=False, capture_output=True)
        subprocess.run(["ip", "netns", "del", self._namespace], check=False, capture_output=True)
        for mount in reversed(list(self._mounts())):
            _run("umount", "--lazy", mount)

    def _own_processes(self) -> list[int]:
        """The processes that name its folder: the daemon, its containerd, and each container's shim."""
        found = []
        for path in Path("/proc").glob("[0-9]*/cmdline"):
            with contextlib.suppress(OSError):
                if str(self.folder).encode() in path.read_bytes() and int(path.parent.name) != os.getpid():
                    found.append(int(path.parent.name))
        return found

    def _mounts(self) -> Iterator[str]:
        for line in Path("/proc/self/mountinfo").read_text().splitlines():
            place = line.split()[4]
            if place.startswith(f"{self.folder}/"):
                yield place

    def _answers(self) -> bool:
        assert self._process is not None
        assert self._process.poll() is None, self.log.read_text()
        with contextlib.suppress(docker.errors.DockerException), contextlib.closing(self.client()) as client:
            return bool(client.ping())
        return False


class Machines:
    """`count` machines; the testbed runs on the first, which has the node image."""

    def __init__(self, count: int) -> None:
        self._folder = Path(tempfile.mkdtemp(prefix="mx"))  # short: a socket's path may have 107 bytes
        self._bridge = self._folder.name[:10]
        self.all = [DockerMachine(self._folder / str(number), self._bridge, number) for number in range(1, count + 1)]

    @property
    def here(self) -> DockerMachine:
        return self.all[0]

    @property
    def others(self) -> Sequence[DockerMachine]:
        return self.all[1:]

    @property
    def environment(self) -> dict[str, str]:
        """The environment variables with which the testbed flies on these machines."""
        return {"DOCKER_HOST": self.here.address, "MACHINES": ",".join(machine.address for machine in self.others)}

    def start(self) -> Self:
        _run("ip", "link", "add", self._bridge, "type", "bridge")
        _run("ip", "link", "set", self._bridge, "up")
        _run("iptables", "--insert", *self._rule)  # Docker drops forwarded packets
        for machine in self.all:
            machine.start()
        save = subprocess.Popen(["docker", "save", NODE], stdout=subprocess.PIPE)
        _run("docker", "--host", self.here.address, "load", "--quiet", stdin=save.stdout)
        assert save.wait() == 0
        return self

    def close(self) -> None:
        with contextlib.ExitStack() as last_first:
            last_first.callback(shutil.rmtree, self._folder)
            for words in (["ip", "link", "del", self._bridge], ["iptables", "--delete", *self._rule]):
                last_first.callback(subprocess.run, words, check=False, capture_output=True)
            for machine in self.all:
                last_first.callback(machine.close)

    @property
    def _rule(self) -> list[str]:
        return ["FORWARD", "-i", self._bridge, "-o", self._bridge, "-j", "ACCEPT"]


def _run(*words: str, stdin: Any = None) -> None:
    subprocess.run(words, check=True, stdin=stdin, stdout=subprocess.DEVNULL)
