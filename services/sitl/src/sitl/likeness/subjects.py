"""Autopilots to record: a real one's process on loopback, the stand-in as a process, or in simulated time."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from abc import ABC, abstractmethod
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Self

from ..errors import SitlError
from ..fleet import DroneConfig
from ..personalities import PERSONALITIES
from ..process import LinkConfig
from ..real.ardupilot import DEFAULTS, PROGRAM
from ..real.ardupilot import ArduCopter as Prepared
from ..real.px4 import link_programs, scheduled
from ..vehicle import Vehicle
from .channel import Channel, Clock, SimulatedChannel, UdpChannel
from .manners import ARDUCOPTER, MANNERS, PX4, Manners
from .pilot import Pilot

STARTED_S = 90.0
"""A real autopilot's estimator has to converge before it arms."""
_END_S = 10.0
PORTS = {"onboard": 14_580, "gcs": 18_570, "normal": 24_580}
"""The ports of PX4's instance 0; the last is the recorder's choice."""
CAMERA_LINK = (
    "mavlink start -x -u $udp_onboard_payload_port_local -r 4000 -f -m onboard -o $udp_onboard_payload_port_remote"
)
"""A PX4 has at most six links: this one is replaced by one with the normal streams, as for a radio."""
OWN = 27_000
"""The first of the recorder's own ports."""


class Subject(ABC):
    """An autopilot that runs while this is entered; `links` are its links' names."""

    manners: Manners
    system: int
    described: str
    links: tuple[str, ...] = ("onboard", "gcs", "normal")

    @abstractmethod
    def open(self, link: str) -> Channel:
        """A new channel to one of its links."""

    @abstractmethod
    def start(self) -> None:
        """Start it."""

    @abstractmethod
    def end(self) -> None:
        """End it."""

    @abstractmethod
    def check(self) -> None:
        """Raises SitlError if it has ended of its own accord."""

    def __enter__(self) -> Self:
        self._channels = ExitStack()
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._channels.close()
        self.end()

    def pilot(self, link: str) -> Pilot:
        """Make a pilot on a link, which is closed when the subject is left."""
        channel = self.open(link)
        self._channels.callback(channel.close)
        return Pilot(channel, self.manners, self.system)


class ProcessSubject(Subject):
    """An autopilot that is a process in a folder of its own."""

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="sitl-record-")
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def folder(self) -> Path:
        return Path(self._folder.name)

    @abstractmethod
    def command(self) -> list[str]:
        """The command line that starts it."""

    def environment(self) -> dict[str, str]:
        """Its environment variables besides the recorder's own."""
        return {}

    def start(self) -> None:
        log = (self.folder / "output.txt").open("wb")
        environment = {**os.environ, **self.environment()}
        try:
            self._process = subprocess.Popen(
                self.command(), cwd=self.folder, env=environment, stdin=subprocess.DEVNULL, stdout=log, stderr=log
            )
        except OSError as error:
            raise SitlError(f"{self.command()[0]}: {error.strerror}") from error

    def end(self) -> None:
        if self._process is not None:
            self._process.terminate()
            try:
                self._process.wait(_END_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        self._folder.cleanup()

    def check(self) -> None:
        """Raises SitlError with its last line of output if it has ended of its own accord."""
        if self._process is not None and self._process.poll() is not None:
            said = (self.folder / "output.txt").read_text(errors="replace").strip().splitlines()[-1:]
            raise SitlError(f"{self.described} ended with {self._process.returncode}: {' '.join(said)}")


class Px4(ProcessSubject):
    """A PX4 with its own simulator, from a folder with bin/px4 and etc; instance N has the ports of N."""

    manners = PX4

    def __init__(self, folder: Path, instance: int) -> None:
        super().__init__()
        self._px4 = folder.resolve()
        for part in ("bin/px4", "bin/px4-alias.sh", "etc/init.d-posix/rcS"):
            if not (self._px4 / part).exists():
                raise SitlError(f"--px4-dir {folder}: expected {part} in it")
        self._instance = instance
        self.system = instance + 1
        self.described = f"PX4 {folder.name}"

    def start(self) -> None:
        """Start it with changed scripts: above instance 9 all PX4s send to one port, where the first listener has the
        link.
        """
        shutil.copytree(self._px4 / "etc", self.folder / "etc")
        (self.folder / "bin").mkdir()
        link_programs(self._px4 / "bin", self.folder / "bin")
        script = self.folder / "etc/init.d-posix/px4-rc.mavlink"
        text = script.read_text()
        for found, made in (
            ("# GCS link\n", f"# GCS link\nudp_offboard_port_remote={self._own('onboard')}\n"),
            (
                "mavlink start -x -u $udp_gcs_port_local -r",
                f"mavlink start -x -u $udp_gcs_port_local -o {self._own('gcs')} -r",
            ),
            (
                CAMERA_LINK,
                f"mavlink start -x -u {PORTS['normal'] + self._instance} -r 4000000 -o {self._own('normal')}",
            ),
        ):
            if found not in text:
                raise SitlError(f"{self.described}: this PX4 starts its links in another way: no {found!r}")
            text = text.replace(found, made)
        script.write_text(text)
        super().start()

    def command(self) -> list[str]:
        return [
            *scheduled(self._instance),
            str(self.folder / "bin/px4"),
            "-d",
            *("-i", str(self._instance)),
            *("-w", str(self.folder), str(self.folder / "etc")),
        ]

    def environment(self) -> dict[str, str]:
        return {"PX4_SIM_MODEL": "sihsim_quadx"}

    def open(self, link: str) -> Channel:
        return UdpChannel(PORTS[link] + self._instance, self._own(link))

    def _own(self, link: str) -> int:
        """The port on which the recorder receives from a link."""
        return OWN + len(PORTS) * self._instance + list(PORTS).index(link)


class ArduCopter(ProcessSubject):
    """An ArduCopter with its own simulator, from a folder with arducopter and copter.parm."""

    manners = ARDUCOPTER
    links = ("onboard",)

    def __init__(self, folder: Path, instance: int) -> None:
        super().__init__()
        for part in (PROGRAM, DEFAULTS):
            if not (folder / part).exists():
                raise SitlError(f"--ardupilot-dir {folder}: expected {part} in it")
        self.system = instance + 1
        self.described = "ArduCopter"
        self._own = OWN + len(PORTS) * instance
        onboard = LinkConfig(("127.0.0.1", 0), ("127.0.0.1", self._own), "px4-onboard")
        work, logs = self.folder / "work", self.folder / "flight-logs"
        self._prepared = Prepared(folder.resolve(), work, logs, DroneConfig(self.system), onboard, self._own + 1)

    def command(self) -> list[str]:
        return self._prepared.prepare()[0]

    def open(self, link: str) -> Channel:
        return UdpChannel(None, self._own)


class StandIn(ProcessSubject):
    """The stand-in as people start it: a process with UDP links, in real time."""

    links = ("onboard",)

    def __init__(self, port: int, like: str) -> None:
        super().__init__()
        self.manners = MANNERS[like]
        self.system = 1
        self.described = "stand-in"
        self._port = port

    def command(self) -> list[str]:
        ports = ["--listen", f"127.0.0.1:{self._port}", "--send", f"127.0.0.1:{self._port + 1}"]
        return [sys.executable, "-m", "sitl", "fly", "--system", "1", "--like", self.manners.name, *ports]

    def open(self, link: str) -> Channel:
        return UdpChannel(self._port, self._port + 1)


class Simulated(Subject):
    """The stand-in's vehicle in simulated time."""

    def __init__(self, like: str) -> None:
        self.manners = MANNERS[like]
        self._vehicle = Vehicle(DroneConfig(1), [f"px4-{link}" for link in self.links], like=PERSONALITIES[like])
        self._clock = Clock()
        self.system = self._vehicle.config.system_id
        self.described = "stand-in"

    def start(self) -> None:
        """It needs no start."""

    def end(self) -> None:
        """There is nothing to end."""

    def check(self) -> None:
        """It does not end."""

    def open(self, link: str) -> Channel:
        return SimulatedChannel(self._vehicle, self.links.index(link), self._clock)


def wait_ready(subject: Subject, pilot: Pilot) -> None:
    """Wait until it reports that it could arm. Raises SitlError if it does not within STARTED_S, or has ended."""
    end_s = time.monotonic() + STARTED_S
    while not pilot.ready:
        subject.check()
        if time.monotonic() >= end_s:
            raise SitlError(f"{subject.described} does not say within {STARTED_S:g} s that it could arm")
        pilot.wait(0.2)
