"""An autopilot's flight by its own messages, on a link for its witness alone; no I/O."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import common as mavlink

WANTED_HZ = {"EXTENDED_SYS_STATE": 20.0, "GLOBAL_POSITION_INT": 10.0, "SYSTEM_TIME": 5.0, "SYS_STATUS": 2.0}
"""The requested messages and their rates. Heartbeats arrive without a request."""
SYSTEM, COMPONENT = 250, mavlink.MAV_COMP_ID_ONBOARD_COMPUTER
"""The sender of requests. It sends no heartbeat: to the autopilot it is no ground station whose loss would matter."""
AGAIN_NS = 2_000_000_000
"""A message that has not arrived for this long is requested (again)."""
EVERY_NS = {"position": 1_000_000_000, "clock": 150_000_000}
"""The shortest intervals between these events; `clock` is written with each SYSTEM_TIME."""
_AIRBORNE = (mavlink.MAV_LANDED_STATE_IN_AIR, mavlink.MAV_LANDED_STATE_TAKEOFF, mavlink.MAV_LANDED_STATE_LANDING)
_IDS = {name: next(i for i, kind in mavlink.mavlink_map.items() if kind.msgname == name) for name in WANTED_HZ}

Event = dict[str, Any]


class Witness:
    """The state that one autopilot has reported so far."""

    def __init__(self, system: int) -> None:
        self.system = system
        self._armed = False
        self._airborne: bool | None = None
        self._marked_ns: dict[str, int] = {}
        self._came_ns: dict[str, int] = {}
        self._asked_ns = 0
        self._codec = mavlink.MAVLink(None, srcSystem=SYSTEM, srcComponent=COMPONENT)
        self.place: dict[str, float] | None = None
        """latitude_deg, longitude_deg, altitude_m above home; None until it is known."""
        self.is_armable = False
        """Whether the autopilot has reported that it would arm."""
        self.heard_ns: int | None = None
        """When its last heartbeat arrived."""
        self.told_ns: int | None = None
        """When its last message of any kind arrived."""

    def take(self, datagram: bytes, t_ns: int) -> list[Event]:
        """The events that a datagram reports, which arrived at `t_ns` (since 1970).

        armed, disarmed, took_off, landed; position once per second (`boot_ms` is the autopilot's own time); clock with
        each SYSTEM_TIME (the autopilot's time when it was sent).
        """
        events: list[Event] = []
        parser = mavlink.MAVLink(None)  # a new one each time: no message spans two datagrams
        parser.robust_parsing = True
        for message in parser.parse_buffer(datagram) or ():
            if (message.get_srcSystem(), message.get_srcComponent()) == (self.system, mavlink.MAV_COMP_ID_AUTOPILOT1):
                self.told_ns = self._came_ns[message.get_type()] = t_ns
                events += self._told(message, t_ns)
        return events

    def requests(self, t_ns: int) -> list[bytes]:
        """Requests for missing messages, once a heartbeat has arrived; at most every two seconds."""
        if self.heard_ns is None or t_ns - self._asked_ns < AGAIN_NS:
            return []
        self._asked_ns = t_ns
        silent = [name for name in WANTED_HZ if t_ns - self._came_ns.get(name, 0) > AGAIN_NS]
        return [self._request(name) for name in silent]

    def _request(self, name: str) -> bytes:
        request = mavlink.MAVLink_command_long_message(
            target_system=self.system,
            target_component=mavlink.MAV_COMP_ID_AUTOPILOT1,
            command=mavlink.MAV_CMD_SET_MESSAGE_INTERVAL,
            confirmation=0,
            param1=_IDS[name],
            param2=1e6 / WANTED_HZ[name],
            param3=0,
            param4=0,
            param5=0,
            param6=0,
            param7=0,
        )
        packed = request.pack(self._codec)
        self._codec.seq = (self._codec.seq + 1) % 256
        return bytes(packed)

    def _told(self, message: Any, t_ns: int) -> list[Event]:
        kind = message.get_type()
        if kind == "HEARTBEAT":
            self.heard_ns = t_ns
            armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
            changed, self._armed = armed != self._armed, armed
            return [{"event": "armed" if armed else "disarmed"}] if changed else []
        if kind == "EXTENDED_SYS_STATE":
            return self._landed(message.landed_state)
        if kind == "GLOBAL_POSITION_INT":
            self.place = {
                "latitude_deg": message.lat / 1e7,
                "longitude_deg": message.lon / 1e7,
                "altitude_m": message.relative_alt / 1e3,
            }
            return self._mark("position", t_ns, message.time_boot_ms, self.place)
        if kind == "SYSTEM_TIME":
            return self._mark("clock", t_ns, message.time_boot_ms, {})
        if kind == "SYS_STATUS":
            self.is_armable |= bool(message.onboard_control_sensors_health & mavlink.MAV_SYS_STATUS_PREARM_CHECK)
        return []

    def _landed(self, state: int) -> list[Event]:
        on_ground = state == mavlink.MAV_LANDED_STATE_ON_GROUND
        if not on_ground and state not in _AIRBORNE:
            return []
        before, self._airborne = self._airborne, not on_ground
        if before is None or before == self._airborne:
            return []
        return [{"event": "took_off" if self._airborne else "landed"}]

    def _mark(self, event: str, t_ns: int, boot_ms: int, detail: dict[str, float]) -> list[Event]:
        if t_ns - self._marked_ns.get(event, 0) < EVERY_NS[event]:
            return []
        self._marked_ns[event] = t_ns
        return [{"event": event, "boot_ms": boot_ms, **detail}]
