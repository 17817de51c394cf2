"""A real ArduCopter with its own simulator, as a process on loopback, and the pilot's station on its second link."""

from __future__ import annotations

import os
import socket
import subprocess
import threading
from pathlib import Path
from typing import Any, Self

from processes import free_port, wait_until
from pymavlink.dialects.v20 import common as mavlink

FOLDER = os.environ.get("ARDUPILOT_DIR", "")
"""A folder with `arducopter` and `copter.parm`."""
SYSTEM = 7
HOME = (47.397742, 8.545594, 488.0)
BOOT_S = 180.0
"""ArduCopter's simulated GPS takes 42 s to a position; more on a machine that does something else."""
_PORTS_EACH = 10


class Copter:
    """ArduCopter in a folder of its own; it keeps its parameters there over a restart."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.port, self.pilots_port = free_port(socket.SOCK_DGRAM), free_port(socket.SOCK_DGRAM)
        self.log = folder / "arducopter.log"
        self._process: subprocess.Popen[bytes] | None = None
        self._base_port = _free_row()
        self._more = folder / "more.parm"
        self._more.write_text("FLTMODE_CH 0\nINITIAL_MODE 4\n")  # its simulated remote control has a switch of modes

    def start(self, wipe: bool = True) -> Self:
        simulated = ["--model", "quad", "--home", ",".join(map(str, (*HOME, 0))), "--sysid", str(SYSTEM)]
        ports = ["--base-port", str(self._base_port), "--rc-in-port", str(self._base_port + 8)]
        ports += ["--irlock-port", str(self._base_port + 9)]
        links = [
            "--serial0",
            f"udpclient:127.0.0.1:{self.port}",
            "--serial1",
            f"udpclient:127.0.0.1:{self.pilots_port}",
        ]
        parameters = [
            "--defaults",
            f"{Path(FOLDER).resolve() / 'copter.parm'},{self._more}",
            *(["--wipe"] if wipe else []),
        ]
        command = [str(Path(FOLDER).resolve() / "arducopter"), *simulated, *ports, *links, *parameters]
        with self.log.open("ab") as log:
            self._process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, cwd=self.folder)
        return self

    def kill(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()


def _free_row() -> int:
    """The first of some ports that are free, one behind another."""
    while True:
        first = free_port()
        if first % 1000 > 1000 - _PORTS_EACH:
            continue
        if all(_is_free(first + more) for more in range(_PORTS_EACH)):
            return first


def _is_free(port: int) -> bool:
    with socket.socket() as sock:
        try:
            sock.bind(("127.0.0.1", port))
        except OSError:
            return False
        return True


class Pilot:
    """What a pilot's station on the aircraft sees and does: the truth that the flights are held to."""

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
        self._ended = False
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._ended = True
        self._thread.join()
        self._socket.close()

    def watch(self) -> Self:
        """Ask for what is looked at, until it comes."""
        for kind in (mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE):
            self.latest.pop(mavlink.mavlink_map[kind].msgname, None)
        wait_until(lambda: "HEARTBEAT" in self.latest, "ArduCopter's heartbeat", BOOT_S)

        def asked() -> bool:
            for kind in (mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE):
                self.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, kind, 1e5)
            return "GLOBAL_POSITION_INT" in self.latest and "EXTENDED_SYS_STATE" in self.latest

        wait_until(asked, "ArduCopter's position", BOOT_S)
        return self

    def command(self, mav_cmd: int, *params: float) -> None:
        self._write(mavlink.MAVLink_command_long_message(SYSTEM, 1, mav_cmd, 0, *params, *[0.0] * (7 - len(params))))

    def set_mode(self, number: int) -> None:
        self.command(mavlink.MAV_CMD_DO_SET_MODE, 1, number)

    def set_parameter(self, name: str, value: float, kind: int = mavlink.MAV_PARAM_TYPE_REAL32) -> None:
        self._write(mavlink.MAVLink_param_set_message(SYSTEM, 1, name.encode(), value, kind))

    @property
    def mode(self) -> int:
        return int(self.latest["HEARTBEAT"].custom_mode)

    @property
    def armed(self) -> bool:
        return bool(self.latest["HEARTBEAT"].base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)

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
                    continue  # ArduPilot passes on what the UAV client says on its link
                self.latest[message.get_type()] = message
                if message.get_type() == "GLOBAL_POSITION_INT":
                    self.highest_m = max(self.highest_m, message.relative_alt / 1000)
