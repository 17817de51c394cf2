"""MAVLink's mission protocol with clients: passes each message to uploads or downloads (docs/gateway.md)."""

from __future__ import annotations

from typing import Any, Final

from pymavlink.dialects.v20 import common as mavlink

from ..protocol.plans import PlanList
from ..protocol.states import Severity
from ..station.views import Drone
from .clients import Client
from .downloads import Downloads
from .texts import send_text
from .uploads import Uploads

MESSAGES: Final = frozenset(
    {
        "MISSION_COUNT", "MISSION_ITEM_INT", "MISSION_ITEM", "MISSION_CLEAR_ALL", "MISSION_ACK",
        "MISSION_REQUEST_LIST", "MISSION_REQUEST_INT", "MISSION_REQUEST", "MISSION_WRITE_PARTIAL_LIST",
    }
)  # fmt: skip
_PARTIAL = "a part of a list is not uploaded: upload the whole list"


class Missions:
    """Handles the mission protocol's messages from all clients."""

    def __init__(self, uploads: Uploads, downloads: Downloads) -> None:
        self._uploads = uploads
        self._downloads = downloads

    def on_message(self, client: Client, drone: Drone, message: Any) -> None:
        """Handle one of MESSAGES."""
        name, number = message.get_type(), message.mission_type
        kinds = list(PlanList) if name == "MISSION_CLEAR_ALL" and number == mavlink.MAV_MISSION_TYPE_ALL else None
        if kinds is None and number not in list(PlanList):
            self._refuse(client, drone, number, f"mission type {number}: expected 0, 1 or 2")
            return
        kind = PlanList(number) if kinds is None else PlanList.MISSION
        if name == "MISSION_COUNT":
            self._uploads.begin(client, drone, kind, message.count)
        elif name == "MISSION_CLEAR_ALL":
            for each in kinds or [kind]:
                self._uploads.begin(client, drone, each, 0)
        elif name in ("MISSION_ITEM_INT", "MISSION_ITEM"):
            self._uploads.on_item(client, drone, kind, message)
        elif name == "MISSION_REQUEST_LIST":
            self._downloads.on_list(client, drone, kind)
        elif name in ("MISSION_REQUEST_INT", "MISSION_REQUEST"):
            self._downloads.on_request(client, drone, kind, message.seq, name == "MISSION_REQUEST_INT")
        elif name == "MISSION_ACK":
            if message.type != mavlink.MAV_MISSION_ACCEPTED:
                self._uploads.on_cancel(client, drone, kind)
        else:
            self._refuse(client, drone, kind, _PARTIAL)

    def tick(self, now_ms: int) -> None:
        """Do what is due in uploads and downloads."""
        self._uploads.tick(now_ms)
        self._downloads.tick(now_ms)

    def _refuse(self, client: Client, drone: Drone, number: int, text: str) -> None:
        unsupported = mavlink.MAV_MISSION_UNSUPPORTED
        refusal = mavlink.MAVLink_mission_ack_message(client.system, client.component, unsupported, number)
        client.peer.send(drone.number, refusal)
        send_text(client.peer, drone.number, Severity.WARNING, text)
