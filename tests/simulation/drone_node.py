"""A simulated UAV client with its journal, and the autopilot that it flies."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from pymavlink.dialects.v20 import common as mavlink

from mqttxt.activator.drones import FOG
from mqttxt.drone.effects import Journal, Transmit
from mqttxt.drone.mavlink.px4 import Px4
from mqttxt.drone.options import UavOptions
from mqttxt.drone.role import UavClient
from mqttxt.protocol.policies import POLICIES
from tests.simulation.kept import Kept
from tests.simulation.nodes import MS, PLACES, Node, S
from tests.simulation.world import ack, from_autopilot, heartbeat, home, landed

if TYPE_CHECKING:
    from tests.simulation.adversary import Simulation

FIGURES = (
    home(),
    landed(2),
    from_autopilot(mavlink.MAVLink_battery_status_message(0, 0, 0, 0, [0] * 10, 0, 0, 0, 90)),
    *(
        from_autopilot(mavlink.MAVLink_param_value_message(name.encode(), 10.0, 9, 1, 0))
        for name in (*Px4.max_speed, *Px4.cruise_speed)
    ),
)
"""The messages of an autopilot's start, among them all that PSMI needs."""


class DroneNode(Node):
    """A UAV client with its journal, and the autopilot that outlives it."""

    brokers = (FOG,)

    def __init__(self, sim: Simulation, number: int) -> None:
        self.number = number
        self.journal = Kept()
        self.armed = True
        self.place = PLACES[0]
        super().__init__(sim, f"drone {number}")
        self._telemetry()

    def make_role(self) -> UavClient:
        left, options = list(self.journal.unfinished.values()), UavOptions(endurance_s=900)
        often = {name: replace(policy, heartbeat_ms=3000) for name, policy in POLICIES.items()}
        seal = self.sim.seal(f"drone{self.number}")
        return UavClient(
            self.number, self.clock.session, self.sim.settings, None, often, left, options=options, seal=seal, fog=1
        )

    def start(self) -> None:
        super().start()
        self._tell()
        for message in FIGURES:
            self.react(self.role.on_mavlink, _of(message, self.number))

    def special(self, output: Any) -> None:
        if isinstance(output, Journal):
            self.journal.takes(output)
            if output.is_opening:
                self.react(self.role.desk.on_journalled, output.id)
        elif isinstance(output, Transmit) and output.ref is not None:
            self._transmit(output)

    def _transmit(self, effect: Transmit) -> None:
        """Write as the runner does: it reads the clock for the last time immediately before the write."""
        late = effect.not_after_ms is not None and self.clock.now_ms() > effect.not_after_ms
        if late and self.sim.dangers.looks_before_the_write:
            self.react(self.role.on_refused, effect.ref, True)
            return
        self.sim.judge.writes(self, effect.ref, (effect.message.command, effect.source))
        self._autopilot(effect)
        self.react(self.role.on_transmitted, effect.ref)

    def _autopilot(self, effect: Transmit) -> None:
        rng, message = self.sim.rng, effect.message
        result = 0 if rng.random() < 0.9 else mavlink.MAV_RESULT_TEMPORARILY_REJECTED
        if result == 0:
            self.sim.judge.takes_on(self, effect.ref)
        if result == 0 and message.command == mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
            self.armed = message.param1 == 1.0
        if result == 0 and message.get_type() == "COMMAND_INT":
            self.place = min(PLACES, key=lambda place: abs(place.lat - message.x))
        if rng.random() >= self.sim.dangers.mute:
            delay_us = rng.randint(1 * MS, 80 * MS) if rng.random() < 0.95 else rng.randint(1 * MS, 2 * S)
            self._soon(delay_us, self._acknowledge, effect, result)

    def _acknowledge(self, effect: Transmit, result: int) -> None:
        answer = ack(effect.message.command, result, source=effect.source)
        self.react(self._on_ack, effect.ref, _of(answer, self.number))
        self._soon(5 * MS, self._tell)

    def _on_ack(self, ref: Any, message: Any, now_ms: int) -> Any:
        self.sim.judge.acknowledges(self, ref)
        return self.role.on_mavlink(message, now_ms)

    def _telemetry(self) -> None:
        self._tell()
        self.sim.events.after(1 * S, self._telemetry)

    def _tell(self) -> None:
        for messages in ((heartbeat(self.armed), landed(2)), (self.place,)):
            self.react(self._on_told, [_of(message, self.number) for message in messages])

    def _on_told(self, messages: list[Any], now_ms: int) -> Any:
        return [effect for message in messages for effect in self.role.on_mavlink(message, now_ms)]


def _of(message: Any, system: int) -> Any:
    """The message as if it were another autopilot's, to its own companion."""
    own = copy(message)
    own.get_srcSystem = lambda: system
    if hasattr(own, "target_system"):
        own.target_system = system
    return own
