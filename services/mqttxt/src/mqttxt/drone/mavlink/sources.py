"""In whose name the UAV client writes to its autopilot: a MAVLink system and component."""

from __future__ import annotations

from enum import Enum

from pymavlink.dialects.v20 import common as mavlink

_GCS_SYSTEM = 255
"""What ground control stations use by convention."""


class Source(Enum):
    """COMPANION is the UAV client itself. What halts is written by a HALT that no other open command has, so that its
    acknowledgements are its own: COMMAND_ACK names whom it answers. GCS is a ground station's heartbeat.
    """

    COMPANION = mavlink.MAV_COMP_ID_ONBOARD_COMPUTER
    HALT = mavlink.MAV_COMP_ID_ONBOARD_COMPUTER2
    HALT_2 = mavlink.MAV_COMP_ID_ONBOARD_COMPUTER3
    HALT_3 = mavlink.MAV_COMP_ID_ONBOARD_COMPUTER4
    GCS = mavlink.MAV_COMP_ID_MISSIONPLANNER

    @property
    def component(self) -> int:
        return int(self.value)

    def system(self, drone: int) -> int:
        """The system id, for the autopilot of a drone."""
        return _GCS_SYSTEM if self is Source.GCS else drone


HALTING = (Source.HALT, Source.HALT_2, Source.HALT_3)
COMMANDING = (Source.COMPANION, *HALTING)
"""Those that write commands, and are acknowledged."""
