"""The roles fly the stand-in in simulated time, without any I/O."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from mqttxt.activator.drones import CLOUD, FOG
from mqttxt.protocol.messages import Word
from mqttxt.station.outcomes import Outcome
from sitl.fleet import DroneConfig
from sitl.outputs import Reply
from sitl.personalities import PERSONALITIES
from sitl.vehicle import Vehicle
from tests.simulation.world import World

STEP_MS = 20


class Flight(World):
    """The world with an autopilot, which exchanges messages with the UAV client."""

    def begin(self, like: str) -> Flight:
        self.have_autopilot(like)
        self.gs.add_fogs([1])
        self.run("activator", self.activator.on_connected(FOG, self.now_ms))
        self.run("activator", self.activator.on_connected(CLOUD, self.now_ms))
        self.run("uav", self.uav.on_connected(FOG, self.now_ms))
        self.run("gs", self.gs.on_connected(CLOUD, self.now_ms))
        self.fly(3)
        return self

    def have_autopilot(self, like: str) -> None:
        self.vehicle = Vehicle(DroneConfig(self.drone, quiet=True), ["px4-normal"], like=PERSONALITIES[like])
        self._late: list[Any] = []
        self._downlink = mavlink.MAVLink(None, srcSystem=self.drone, srcComponent=1)

    def step_autopilot(self) -> None:
        """The autopilot's next step, at `now_ms`."""
        now_s = self.now_ms / 1000
        late, self._late = self._late, []
        self._hear(late)
        self._hear([o.message for o in self.vehicle.advance(now_s) if isinstance(o, Reply)])
        self._hear(self.vehicle.streamed(0, now_s))

    def fly(self, seconds: float) -> None:
        for _ in range(round(seconds * 1000 / STEP_MS)):
            self.now_ms += STEP_MS
            self.step_autopilot()
            for name in ("uav", "activator", "gs"):
                self.run(name, getattr(self, name).tick(self.now_ms))

    def outcome(self, command: Any, limit_s: float = 120, **options: Any) -> tuple[Word, str | None]:
        """Send a command and fly until its last word; returns that and its reason."""
        sent = self.send(command, **options)
        for _ in range(round(limit_s)):
            if (last := self.last_of(sent)) is not None:
                return last.word, last.reason
            self.fly(1)
        raise AssertionError(f"{command}: no last word in {limit_s:g} s")

    def set(self, **wanted: Any) -> None:
        """Set the vehicle's state past all links; `mode` acts as a pilot's change."""
        _, out = self.vehicle.control({"set": wanted})
        self._hear([o.message for o in out if isinstance(o, Reply)])

    @property
    def mode(self) -> str:
        return str(self.vehicle.autopilot.mode.name)

    @property
    def up_m(self) -> float:
        return float(self.vehicle.autopilot.motion.position[2])

    def last_of(self, sent: Any) -> Outcome | None:
        """The last word on a command, None before it."""
        words = [o for o in self.heard if isinstance(o, Outcome) and o.id == sent]
        return words[-1] if words and words[-1].is_last else None

    def _hear(self, messages: list[Any]) -> None:
        for message in messages:
            for parsed in mavlink.MAVLink(None).parse_buffer(message.pack(self._downlink)) or ():
                self.autopilot(parsed)

    def _arrives(self, effect: Any) -> bool:
        """Whether a write of the UAV client reaches the autopilot."""
        return effect.not_after_ms is None or self.now_ms <= effect.not_after_ms

    def _write(self, effect: Any) -> None:
        super()._write(effect)
        if not self._arrives(effect):
            return
        for parsed in (
            mavlink.MAVLink(None).parse_buffer(
                effect.message.pack(mavlink.MAVLink(None, self.drone, effect.source.component))
            )
            or ()
        ):
            answers = [o.message for o in self.vehicle.handle(0, parsed) if isinstance(o, Reply)]
            if parsed.get_type().startswith(("MISSION_", "PARAM_")):
                self._late += answers  # one answer leads to the next: hundreds of them within each other are too deep
            else:
                self._hear(answers)
