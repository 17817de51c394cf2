"""The MAVLink systems and components in whose name the UAV client writes to its autopilot."""

from __future__ import annotations

from enum import Enum

from pymavlink.dialects.v20 import common as mavlink

_GCS_SYSTEM = 255
"""The system id of ground control stations by convention."""


class Source(Enum):
    """COMPANION is the UAV client itself. GCS sends a ground station's heartbeat.

    A HALT component writes each hold and pause, and a land, return or disarm whose number is not free: COMMAND_ACK
    names the component that it answers, and so the command.
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
        """The source's MAVLink system id on a drone."""
        return _GCS_SYSTEM if self is Source.GCS else drone


HALTING = (Source.HALT, Source.HALT_2, Source.HALT_3)
COMMANDING = (Source.COMPANION, *HALTING)
"""The sources that write commands and get acknowledgements."""
