"""MQTT-XT's roles fly a real autopilot with its own simulator; a pilot's station watches on its second link."""

from __future__ import annotations

import asyncio
import socket
import struct
import subprocess
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, ClassVar, Self

from pymavlink.dialects.v20 import common as mavlink

from mqttxt import Drone, GroundStation
from mqttxt.drone.mavlink.key_install import Installation
from mqttxt.drone.mavlink.signing import read_key
from mqttxt.drone.mavlink.stamps import Stamps
from mqttxt.drone.mavlink.transports import AutopilotAddress
from mqttxt.errors import TransportError
from tests.rigs.commanding import BOOT_S, armable
from tests.rigs.processes import Broker, Process, eventually, free_port, wait_until

SYSTEM = 7
HOME = (47.397742, 8.545594, 488.0)
STEADY_S = 5.0
_WATCHED = (
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS,
)


class Autopilot(ABC):
    """A process on loopback; it sends to `port` of the UAV client and to the pilot's `pilots_port`."""

    def __init__(self, folder: Path, name: str) -> None:
        self.port, self.pilots_port = free_port(socket.SOCK_DGRAM), free_port(socket.SOCK_DGRAM)
        self._log = folder / f"{name}.log"
        self._process: subprocess.Popen[bytes] | None = None

    @abstractmethod
    def start(self) -> None: ...

    def kill(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    def _run(self, words: Sequence[str], folder: Path, environment: Mapping[str, str] | None = None) -> None:
        with self._log.open("ab") as log:
            self._process = subprocess.Popen(
                words, stdin=subprocess.DEVNULL, stdout=log, stderr=log, cwd=folder, env=environment
            )


class Pilot(ABC):
    """A pilot's station on the aircraft: it sees the truth with which the flights are compared."""

    landing: ClassVar[Any]
    """The mode in which it lands."""

    def __init__(self, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", port))
        self._socket.settimeout(0.2)
        self._peer: Any = None
        self._codec = mavlink.MAVLink(None, srcSystem=250, srcComponent=190)
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True
        self.latest: dict[str, Any] = {}
        self.highest_m = 0.0
        self._would_not_arm_at = 0.0
        self._ended = False
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    @property
    @abstractmethod
    def mode(self) -> Any:
        """The mode in the numbers of its kind."""

    @abstractmethod
    def set_mode(self, mode: Any) -> None: ...

    def close(self) -> None:
        self._ended = True
        self._thread.join()
        self._socket.close()

    def sign(self, key: bytes) -> None:
        """Sign with `key` from now on."""
        signing = self._codec.signing
        signing.timestamp = Stamps().now()
        signing.secret_key, signing.sign_outgoing = key, True

    def watch(self) -> None:
        """Request the watched messages until they arrive."""
        names = {mavlink.mavlink_map[kind].msgname for kind in _WATCHED}
        for name in names:
            self.latest.pop(name, None)
        wait_until(lambda: "HEARTBEAT" in self.latest, "the autopilot's heartbeat", BOOT_S)

        def asked() -> bool:
            for kind in _WATCHED:
                self.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, kind, 1e5)
            return names <= self.latest.keys()

        wait_until(asked, f"the autopilot's {', '.join(sorted(names))}", BOOT_S)

    def command(self, mav_cmd: int, *params: float) -> None:
        self._write(mavlink.MAVLink_command_long_message(SYSTEM, 1, mav_cmd, 0, *params, *[0.0] * (7 - len(params))))

    def set_parameter(self, name: str, value: float, kind: int = mavlink.MAV_PARAM_TYPE_REAL32) -> None:
        self._write(mavlink.MAVLink_param_set_message(SYSTEM, 1, name.encode(), value, kind))

    def set_whole_parameter(self, name: str, value: int) -> None:
        """PX4's encoding: an integer is sent as the bits of a float."""
        bits = struct.unpack("<f", struct.pack("<i", value))[0]
        self.set_parameter(name, bits, mavlink.MAV_PARAM_TYPE_INT32)

    def ask_for_parameter(self, name: str) -> None:
        self._write(mavlink.MAVLink_param_request_read_message(SYSTEM, 1, name.encode(), -1))

    @property
    def custom_mode(self) -> int:
        return int(self.latest["HEARTBEAT"].custom_mode)

    @property
    def armed(self) -> bool:
        return bool(self.latest["HEARTBEAT"].base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)

    @property
    def would_arm(self) -> bool:
        """Whether the autopilot reports that it would arm."""
        return _would_arm(self.latest["SYS_STATUS"])

    @property
    def would_still_arm(self) -> bool:
        """Whether it has reported so for STEADY_S."""
        return self.would_arm and time.monotonic() - self._would_not_arm_at > STEADY_S

    @property
    def landed(self) -> bool:
        return bool(self.latest["EXTENDED_SYS_STATE"].landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND)

    @property
    def position_m(self) -> tuple[float, float, float]:
        """Metres north, east and up of home."""
        seen = self.latest["GLOBAL_POSITION_INT"]
        north_m = (seen.lat / 1e7 - HOME[0]) * 111_195
        return north_m, (seen.lon / 1e7 - HOME[1]) * 75_269, seen.relative_alt / 1000

    @property
    def speed_m_s(self) -> float:
        seen = self.latest["GLOBAL_POSITION_INT"]
        return float((seen.vx**2 + seen.vy**2) ** 0.5 / 100)

    def _write(self, message: Any) -> None:
        self._socket.sendto(message.pack(self._codec), self._peer)

    def _listen(self) -> None:
        while not self._ended:
            try:
                data, self._peer = self._socket.recvfrom(65_536)
            except TimeoutError:
                continue
            for message in self._parser.parse_buffer(data) or ():
                if (message.get_srcSystem(), message.get_srcComponent()) != (SYSTEM, 1):
                    continue  # ArduPilot passes on what the UAV client sends on its link
                self.latest[message.get_type()] = message
                if message.get_type() == "GLOBAL_POSITION_INT":
                    self.highest_m = max(self.highest_m, message.relative_alt / 1000)
                if message.get_type() == "SYS_STATUS" and not _would_arm(message):
                    self._would_not_arm_at = time.monotonic()


def _would_arm(status: mavlink.MAVLink_sys_status_message) -> bool:
    return bool(status.onboard_control_sensors_health & mavlink.MAV_SYS_STATUS_PREARM_CHECK)


class Flight:
    """The autopilot, its pilot, the brokers and the roles, shared by a file's tests: arming takes a minute."""

    def __init__(self, folder: Path, autopilot: Autopilot, pilot: Pilot, key_file: Path | None = None) -> None:
        """With `key_file` the autopilot gets that key before its client starts; `signs`: whether it took the key."""
        self.folder, self.key_file = folder, key_file
        self.signs = False
        self.autopilot, self.pilot = autopilot, pilot
        self.cloud, self.fog = Broker(folder, "cloud"), Broker(folder, "fog")
        fog = ["--fog", "1", "--cloud", self.cloud.url, "--fog-broker", self.fog.url, "--drones", str(SYSTEM)]
        ready = ["--ready-file", str(folder / "activator.ready")]
        self.activator = Process(folder, "activator", "mqttxt", "activator", *fog, *ready)
        keyed = [] if key_file is None else ["--mavlink-key", str(key_file)]
        self.uav = Process(folder, "uav", "mqttxt", "uav", *self.uav_options("uav"), *keyed)

    def uav_options(self, name: str) -> list[str]:
        """The options of a UAV client without a key."""
        address = f"udp:127.0.0.1:{self.autopilot.port}"
        drone = ["--drone", str(SYSTEM), "--broker", self.fog.url, "--autopilot", address]
        files = [f"{name}.journal", f"{name}.ready"]
        return [*drone, "--journal", str(self.folder / files[0]), "--ready-file", str(self.folder / files[1])]

    def __enter__(self) -> Self:
        try:
            for broker in (self.cloud, self.fog):
                broker.start()
            self.start_autopilot()
            if self.key_file is not None:
                self.signs = self._install(read_key(self.key_file))
            self.activator.start().wait_ready()
            self.uav.start()
            if self.key_file is None or self.signs:
                self.uav.wait_ready()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.pilot.close()
        for process in (self.uav, self.activator, self.autopilot, self.fog, self.cloud):
            process.kill()

    def _install(self, key: bytes) -> bool:
        address = AutopilotAddress("udp", "127.0.0.1", self.autopilot.port)
        try:
            asyncio.run(Installation(address, SYSTEM, key).run())
        except TransportError:
            return False
        self.pilot.sign(key)
        return True

    def start_autopilot(self) -> None:
        self.autopilot.start()
        self.pilot.watch()

    @asynccontextmanager
    async def drone(self) -> AsyncIterator[Drone]:
        """Yield the drone on the ground, disarmed and under this station's control; bring it down afterwards."""
        async with GroundStation(self.cloud.url) as station:
            (fog,) = await station.connect([1])
            drone = fog.drone(SYSTEM)
            await self._have_an_autopilot_that_would_arm()
            await armable(drone)
            self.pilot.highest_m = self.pilot.position_m[2]
            yield drone
            if self.pilot.armed:
                self.pilot.set_mode(self.pilot.landing)
                await eventually(lambda: not self.pilot.armed, "landed", 120)

    async def _have_an_autopilot_that_would_arm(self) -> None:
        """Restart an autopilot that would not arm: PX4 may reject its GNSS for good after a flight ("GPS Vertical Pos
        Drift too high"). For a moment PX4 1.15 would not arm some seconds after a flight ("Yaw estimate error").
        """
        try:
            await eventually(lambda: self.pilot.would_still_arm, "the autopilot would arm", BOOT_S / 2)
        except AssertionError:
            self.autopilot.kill()
            await asyncio.to_thread(self.start_autopilot)
