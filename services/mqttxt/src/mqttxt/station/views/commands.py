"""The commands to a drone by their names."""

from __future__ import annotations

from abc import ABC, abstractmethod

from ...core.clock import DEFAULT_TTL_MS
from ...protocol.commands import (
    Arm,
    ClearPlan,
    Command,
    Disarm,
    Goto,
    Hold,
    Land,
    Pause,
    Resume,
    Return,
    SetCurrentItem,
    SetParameter,
    StartMission,
    Takeoff,
)
from ..heard import SentCommand
from ..outcomes import Outcome
from ..plan import Plan

TTL_S = DEFAULT_TTL_MS / 1000


class DroneCommands(ABC):
    """One method per command of a drone; each calls `send`."""

    @abstractmethod
    def send(
        self, command: Command, *, ttl_s: float = TTL_S, limit_s: float | None = None
    ) -> SentCommand[Outcome, Outcome]:
        """`Drone.send`."""

    def arm(self, *, ttl_s: float = TTL_S, limit_s: float | None = None) -> SentCommand[Outcome, Outcome]:
        """Start the motors; completed when the autopilot reports itself armed."""
        return self.send(Arm(), ttl_s=ttl_s, limit_s=limit_s)

    def disarm(self, *, ttl_s: float = TTL_S, limit_s: float | None = None) -> SentCommand[Outcome, Outcome]:
        """Stop the motors, on the ground only: it is never forced."""
        return self.send(Disarm(), ttl_s=ttl_s, limit_s=limit_s)

    def takeoff(
        self, altitude_m: float, *, ttl_s: float = TTL_S, limit_s: float | None = None
    ) -> SentCommand[Outcome, Outcome]:
        """Climb; completed when airborne at the altitude.

        Parameters:
            altitude_m: metres above home, 0.5 to 10,000.
        """
        return self.send(Takeoff(altitude_m), ttl_s=ttl_s, limit_s=limit_s)

    def goto(
        self,
        latitude_deg: float,
        longitude_deg: float,
        altitude_m: float,
        *,
        ttl_s: float = TTL_S,
        limit_s: float | None = None,
    ) -> SentCommand[Outcome, Outcome]:
        """Fly to a position; completed on arrival.

        Parameters:
            latitude_deg: degrees north, WGS84.
            longitude_deg: degrees east, WGS84.
            altitude_m: metres above home, -500 to 10,000.
        """
        return self.send(Goto(latitude_deg, longitude_deg, altitude_m), ttl_s=ttl_s, limit_s=limit_s)

    def hold(self, *, ttl_s: float = TTL_S, limit_s: float | None = None) -> SentCommand[Outcome, Outcome]:
        """Stop and stay; completed when the drone stands still in its hold mode."""
        return self.send(Hold(), ttl_s=ttl_s, limit_s=limit_s)

    def land(self, *, ttl_s: float = TTL_S, limit_s: float | None = None) -> SentCommand[Outcome, Outcome]:
        """Land where it is; completed when landed and disarmed."""
        return self.send(Land(), ttl_s=ttl_s, limit_s=limit_s)

    def return_home(self, *, ttl_s: float = TTL_S, limit_s: float | None = None) -> SentCommand[Outcome, Outcome]:
        """Return to the take-off point and land there; completed when landed and disarmed."""
        return self.send(Return(), ttl_s=ttl_s, limit_s=limit_s)

    def set_parameter(
        self, name: str, value: float, *, ttl_s: float = TTL_S, limit_s: float | None = None
    ) -> SentCommand[Outcome, Outcome]:
        """Set a parameter of the autopilot; completed when it was read back as that value.

        Parameters:
            name: the parameter, at most 16 characters.
            value: its new value; a whole number for an integer parameter.
        """
        return self.send(SetParameter(name, value), ttl_s=ttl_s, limit_s=limit_s)

    def clear_plan(self, *, ttl_s: float = TTL_S, limit_s: float | None = None) -> SentCommand[Outcome, Outcome]:
        """Remove mission, geofence and rally points; completed when they were read back as empty."""
        return self.send(ClearPlan(), ttl_s=ttl_s, limit_s=limit_s)

    def start_mission(
        self, plan: Plan, item: int = 1, *, ttl_s: float = TTL_S, limit_s: float | None = None
    ) -> SentCommand[Outcome, Outcome]:
        """Fly the mission of a plan, if that is the one that the drone has; completed at its end.

        Parameters:
            plan: the plan with the mission.
            item: where to begin, counted from 1.
        """
        return self.send(StartMission(plan.mission_hash, item), ttl_s=ttl_s, limit_s=limit_s)

    def pause(self, *, ttl_s: float = TTL_S, limit_s: float | None = None) -> SentCommand[Outcome, Outcome]:
        """Stop the mission that is flown, and stay; completed when the drone stands still."""
        return self.send(Pause(), ttl_s=ttl_s, limit_s=limit_s)

    def resume(
        self, plan: Plan, *, ttl_s: float = TTL_S, limit_s: float | None = None
    ) -> SentCommand[Outcome, Outcome]:
        """Fly the mission of a plan on from its current item; completed at its end.

        Parameters:
            plan: the plan with the mission.
        """
        return self.send(Resume(plan.mission_hash), ttl_s=ttl_s, limit_s=limit_s)

    def set_current_item(
        self, plan: Plan, item: int, *, ttl_s: float = TTL_S, limit_s: float | None = None
    ) -> SentCommand[Outcome, Outcome]:
        """Make an item of a plan's mission the current one; a mission that is flown goes on from there.

        Parameters:
            plan: the plan with the mission.
            item: the item, counted from 1.
        """
        return self.send(SetCurrentItem(plan.mission_hash, item), ttl_s=ttl_s, limit_s=limit_s)
