"""The gateway: shows drones to every client, and passes each client's messages to their drone."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from ..core.clock import SessionClock
from ..drone.mavlink.plans import AUTOPILOT_COMPONENT
from ..errors import MqttxtError
from ..protocol.mavlink_states import kinds
from ..protocol.states import (
    Airframe,
    Armed,
    AutopilotText,
    FlightMode,
    LandedState,
    MavlinkState,
    Mission,
    Severity,
    VelocityNed,
)
from ..protocol.topics import MAVLINK_STATE
from ..station.ground_station import GroundStation
from ..station.outcomes import ControlChanged, Outcome, Reachability, StateUpdate
from ..station.views import STALE_MS, Drone, Fog
from .answers import Answers
from .client_commands import acknowledge, text_of
from .clients import Client, Clients
from .control import ClientControl
from .desk import Desk
from .downloads import Downloads
from .endpoints import ClientAddress, Endpoints, Peer
from .missions import MESSAGES, Missions
from .parameter_copies import ParameterCopies
from .parameters import MESSAGES as PARAMETER_MESSAGES
from .parameters import ClientParameters
from .plan_copies import PlanCopies
from .settings import ClientSettings
from .standstill import Standstill
from .telemetry import LOCAL, Turns, View
from .texts import send_text
from .translation import Request, is_of_protocol
from .uploads import Uploads
from .work import Work

logger = logging.getLogger("mqttxt.gateway")

TICK_S = 0.05
REVIEW_MS = 1000
SILENT_MS = 10_000
"""After this long without a `velocity`, which is published at least every 3 s, HEARTBEAT stops (R3.11)."""
TEXT_AGE_MS = 10_000
"""The age from which on a text is not shown: it was meant for earlier clients."""
CONFLICT_MS = 10_000
"""How long a drone stays hidden at a socket after a client there has used its id."""
_COMMANDS = ("COMMAND_LONG", "COMMAND_INT", "SET_MODE", "MISSION_SET_CURRENT")
_AT_ONCE = {
    Armed.name: "HEARTBEAT",
    FlightMode.name: "HEARTBEAT",
    Airframe.name: "HEARTBEAT",
    LandedState.name: "EXTENDED_SYS_STATE",
    Mission.name: "MISSION_CURRENT",
}


@dataclass(frozen=True)
class _Serving:
    """What serves clients while the gateway runs."""

    desk: Desk
    missions: Missions
    parameters: ClientParameters


class Gateway:
    """Shows the drones of some fogs as MAVLink vehicles.

    Parameters:
        station: the station, with `control=False` and entered.
        ttl_s: seconds within which a command must start.
        take_over: whether a client that commands takes control from other clients and stations.
    """

    def __init__(self, station: GroundStation, ttl_s: float, take_over: bool) -> None:
        self._station = station
        self._ttl_s = ttl_s
        self._fogs: list[Fog] = []
        self._turns = Turns()
        self._answers = Answers(self._turns)
        self._clients = Clients()
        self._control = ClientControl(station, self._clients, self._now_ms, take_over)
        self._endpoints = Endpoints(self._on_message, self._clients.on_gone)
        self._shown: set[int] = set()
        self._unknown: set[int] = set()
        self._conflicts: dict[tuple[Peer, int], int] = {}
        self._clock = SessionClock()
        self._standstill = Standstill()
        self._copies = PlanCopies()
        self._parameter_copies = ParameterCopies()
        self._reached: dict[int, int] = {}
        self._serving: _Serving | None = None

    async def run(self, fogs: list[Fog], to: list[ClientAddress], listen: list[ClientAddress]) -> None:
        """Serve until cancelled, or until the station has ended; raises ConfigurationError for a bad address."""
        self._fogs = fogs
        try:
            await self._endpoints.open(to, listen)
            async with asyncio.TaskGroup() as group:
                work = Work(self._control, self._view, self._now_ms, group, self._ttl_s)
                uploads = Uploads(work, self._copies)
                self._serving = serving = _Serving(
                    Desk(work, uploads),
                    Missions(uploads, Downloads(work, self._copies, uploads)),
                    ClientParameters(
                        work, self._parameter_copies, ClientSettings(work, self._parameter_copies, self._send)
                    ),
                )
                ticking = group.create_task(self._tick(serving))
                try:
                    await self._listen()
                finally:
                    self._serving = None  # from now on clients' messages are not handled
                ticking.cancel()
                uploads.close()
        except* MqttxtError as errors:
            raise errors.exceptions[0] from None
        finally:
            await self._endpoints.close()

    def _now_ms(self) -> int:
        return self._clock.now_ms()

    def _view(self, drone: Drone) -> View:
        return View(drone.number, drone.states, self._now_ms())

    def _drones(self) -> dict[int, Drone]:
        """Every drone by its number; one that two fogs know, as seen by the fog that reaches it."""
        found: dict[int, Drone] = {}
        for drone in (drone for fog in self._fogs for drone in fog.drones):
            if drone.number not in found or drone.is_reachable:
                found[drone.number] = drone
        return dict(sorted(found.items()))

    async def _listen(self) -> None:
        """Handle the station's events as they arrive."""
        async for event in self._station.events():
            if isinstance(event, StateUpdate):
                self._on_state(event)
            elif isinstance(event, Reachability) and not event.reachable:
                self._forget(event.drone)
            elif isinstance(event, ControlChanged) and not event.mine and event.holder is not None:
                self._on_taken(event, event.holder)
            elif isinstance(event, Outcome) and event.settled and event.drone is not None:
                for peer in self._audience(event.drone):
                    send_text(peer, event.drone, Severity.WARNING, text_of(event))

    def _on_taken(self, event: ControlChanged, holder: str) -> None:
        """Another station controls a drone at a fog; that counts only at the fog by which the drone is commanded."""
        self._forget(event.drone)
        drone = self._drones().get(event.drone)
        if drone is not None and drone.fog == event.fog and self._serving is not None:
            self._serving.desk.on_taken(event.drone)
            self._control.on_taken(drone, holder)

    def _forget(self, drone: int) -> None:
        """Invalidate the copies of a drone's plan and parameters, which may have changed."""
        self._copies.forget(drone)
        self._parameter_copies.forget(drone)

    def _on_state(self, update: StateUpdate) -> None:
        state = update.state
        self._copies.on_state(update.drone, state)
        if isinstance(state, Mission):
            self._on_progress(update.drone, state.reached)
        if state.name in _AT_ONCE:
            self._turns.hasten(update.drone, _AT_ONCE[state.name])
        elif isinstance(state, AutopilotText) and update.age_ms is not None and update.age_ms <= TEXT_AGE_MS:
            for peer in self._audience(update.drone):
                send_text(peer, update.drone, state.severity, state.text)
        elif isinstance(state, MavlinkState):
            name = state.name.removeprefix(MAVLINK_STATE)
            if name not in LOCAL and not is_of_protocol(name):
                self._send(update.drone, [_as_message(state)])

    def _on_progress(self, drone: int, reached: int) -> None:
        """Send MISSION_ITEM_REACHED, once per item."""
        before, self._reached[drone] = self._reached.get(drone), reached
        known = self._drones().get(drone)
        if known is not None and reached > 0 and before is not None and before != reached:
            self._send(drone, [mavlink.MAVLink_mission_item_reached_message(self._view(known).seq(reached))])

    async def _tick(self, serving: _Serving) -> None:
        """Send due messages, and tick the commands, missions, parameters and control."""
        next_review_ms = 0
        while True:
            now_ms, drones = self._now_ms(), self._drones()
            if self._standstill.is_over(now_ms):
                serving.desk.on_stall()
            for drone in drones.values():
                self._show(drone)
            serving.desk.tick(now_ms)
            serving.missions.tick(now_ms)
            serving.parameters.tick(now_ms)
            if now_ms >= next_review_ms:
                next_review_ms = now_ms + REVIEW_MS
                self._clients.forget(now_ms)
                self._conflicts = {who: at for who, at in self._conflicts.items() if now_ms - at <= CONFLICT_MS}
                for drone in drones.values():
                    self._control.review(drone, self._view(drone).get(Armed))
            await asyncio.sleep(TICK_S)

    def _show(self, drone: Drone) -> None:
        due = self._turns.due(drone.number, self._now_ms())
        if not due:
            return
        view = self._view(drone)
        is_known = LOCAL["HEARTBEAT"].make(view) is not None
        is_shown = is_known and is_heard(drone)
        if is_shown != (drone.number in self._shown):
            logger.info("drone %d: %s", drone.number, "is there" if is_shown else "is silent; its HEARTBEAT stops")
            (self._shown.add if is_shown else self._shown.discard)(drone.number)
        if drone.is_reachable and view.get(Armed) is not None and not is_known and drone.number not in self._unknown:
            self._unknown.add(drone.number)
            logger.warning("drone %d does not publish its kind: start its UAV client with --all-states", drone.number)
        if is_shown:
            made = (LOCAL[name].make(view) for name in due)
            self._send(drone.number, [message for message in made if message is not None])

    def _audience(self, drone: int) -> list[Peer]:
        return [peer for peer in self._endpoints.peers if (peer, drone) not in self._conflicts]

    def _send(self, drone: int, messages: Iterable[Any]) -> None:
        audience = self._audience(drone)
        for message in messages:
            for peer in audience:
                peer.send(drone, message)

    def _on_message(self, peer: Peer, message: Any) -> None:
        """Handle a client's message. Ignored are those to no drone here, and from a client with a drone's id."""
        client = Client(peer, message.get_srcSystem(), message.get_srcComponent())
        drones, kind, is_late = self._drones(), message.get_type(), self._standstill.is_late(self._now_ms())
        if client.system in drones:
            self._refuse(client)
            return
        if is_late and kind not in _COMMANDS:
            return
        if kind == "HEARTBEAT":
            self._clients.on_heartbeat(client, self._now_ms())
            return
        drone = drones.get(getattr(message, "target_system", getattr(message, "target", 0)))
        component = getattr(message, "target_component", AUTOPILOT_COMPONENT)
        if drone is None or component not in (0, AUTOPILOT_COMPONENT):
            return
        serving = self._serving
        if serving is None:
            return
        if kind in _COMMANDS:
            self._on_command(serving.desk, client, drone, message, is_late)
            return
        if kind in MESSAGES:
            serving.missions.on_message(client, drone, message)
            return
        if kind in PARAMETER_MESSAGES:
            serving.parameters.on_message(client, drone, message)
            return
        messages, text = self._answers.on_message(message, client, self._view(drone))
        for answer in messages:
            peer.send(drone.number, answer)
        if text is not None:
            send_text(peer, drone.number, Severity.WARNING, text)

    def _on_command(self, desk: Desk, client: Client, drone: Drone, message: Any, is_late: bool) -> None:
        request = Request.of(message)
        answer = self._answers.on_command(request, self._view(drone))
        if answer is None:
            confirmation = getattr(message, "confirmation", 0)
            takeoff_m = self._parameter_copies.takeoff_m(drone.number)
            desk.on_request(client, drone, request, confirmation, takeoff_m, is_late=is_late)
            return
        result, wanted = answer
        acknowledge(client, drone.number, request, result)
        if wanted is not None:
            client.peer.send(drone.number, wanted)

    def _refuse(self, client: Client) -> None:
        """Hide a drone from a socket where a client has its id: receivers could not tell them apart."""
        key = (client.peer, client.system)
        if key not in self._conflicts:
            logger.warning(
                "drone %d is not shown at %s: a client there has its system id", client.system, client.peer.name
            )
        self._conflicts[key] = self._now_ms()


def is_heard(drone: Drone) -> bool:
    """Whether the fog reaches a drone, and its newest velocity is recent or, before the first one, its arming."""
    velocity, armed = drone.state(VelocityNed), drone.state(Armed)
    known, most_ms = (armed, STALE_MS) if velocity is None else (velocity, SILENT_MS)
    return drone.is_reachable and (known is None or known.age_ms is None or known.age_ms <= most_ms)


def _as_message(state: MavlinkState) -> Any:
    """The MAVLink message that a drone has published as a state."""
    return kinds()[state.name.removeprefix(MAVLINK_STATE)](
        **{name: _field(value) for name, value in state.values.items()}
    )


def _field(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_field(item) for item in value]
    return math.nan if value is None else value.encode() if isinstance(value, str) else value
