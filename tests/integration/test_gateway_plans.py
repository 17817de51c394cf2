"""Plans through MAVLink at the ground, with the clients that people have: MAVSDK, MAVProxy, pymavlink's mavwp."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from mavsdk.asyncio import Mavsdk
from mavsdk.asyncio.plugins.geofence import GeofenceAsync
from mavsdk.asyncio.plugins.mission import MissionAsync
from mavsdk.asyncio.plugins.mission_raw import MissionRawAsync, MissionRawError
from mavsdk.plugins.geofence import Circle, FenceType, GeofenceData, Point, Polygon
from mavsdk.plugins.mission import MissionItem, MissionPlan
from mavsdk.plugins.mission_raw import MissionItem as RawItem
from pymavlink import mavwp
from pymavlink.dialects.v20 import common as mavlink

from mqttxt import Plan
from mqttxt.security.rights import Rights
from tests.integration.test_plans import gs
from tests.rigs.gateway import NAN, Client, Flight, Ground, eventually, signing_client, systems
from tests.rigs.mavproxy import MavProxy
from tests.rigs.processes import wait_until
from tests.rigs.secure_system import SecureSystem

pytestmark = [pytest.mark.integration, pytest.mark.apart]
LATITUDE, LONGITUDE = 47.397742, 8.545594
M_PER_DEGREE = 111_195
RELATIVE = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT
WAYPOINT, TAKEOFF, RETURN = 16, 22, 20
MISSION, FENCE, RALLY = range(3)
TAKEN = "Got MISSION_ACK: TYPE_MISSION: ACCEPTED"


def point(north_m: float, action: Any = MissionItem.VehicleAction.NONE) -> MissionItem:
    place = {"latitude_deg": LATITUDE + north_m / M_PER_DEGREE, "longitude_deg": LONGITUDE, "relative_altitude_m": 5.0}
    other = dict.fromkeys(("speed_m_s", "gimbal_pitch_deg", "gimbal_yaw_deg", "loiter_time_s", "yaw_deg"), NAN)
    camera = {"camera_photo_interval_s": 1.0, "camera_photo_distance_m": NAN, "acceptance_radius_m": 2.0}
    none = MissionItem.CameraAction.NONE
    return MissionItem(**place, **other, **camera, is_fly_through=True, camera_action=none, vehicle_action=action)


def raw(seq: int, command: int, kind: int = MISSION, frame: int = RELATIVE, x: float = LATITUDE) -> RawItem:
    where = {"x": round(x * 1e7), "y": round((LONGITUDE + seq / 1e4) * 1e7), "z": 10.0}
    params = {f"param{number}": 0.0 for number in range(1, 5)}
    head = {"seq": seq, "frame": frame, "command": command, "current": int(seq == 0), "autocontinue": 1}
    return RawItem(**head, **params, **where, mission_type=kind)


def back(seq: int) -> RawItem:
    """The return, which has no place."""
    none = {f"param{number}": 0.0 for number in range(1, 5)} | {"x": 0, "y": 0, "z": 0.0}
    head = {"seq": seq, "frame": mavlink.MAV_FRAME_MISSION, "command": RETURN, "current": 0, "autocontinue": 1}
    return RawItem(**head, **none, mission_type=MISSION)


def downloaded(ground: Ground, folder: Path, drone: int = 1) -> Plan:
    """What the drone has, as another station reads it, which takes control for that."""
    path = folder / f"drone{drone}.plan"
    done = gs(ground, "plan", "download", str(path), "--drone", str(drone), "--take-over")
    assert done.returncode == 0, done.stderr
    return Plan.load(path)


async def test_mavsdk_uploads_flies_and_downloads_a_mission(ground: Ground, mavsdk: Mavsdk) -> None:
    system = (await systems(mavsdk))[1]
    flight, mission = Flight(system), MissionAsync(system)
    await eventually(flight.telemetry.health, lambda health: health.is_armable)
    plan = MissionPlan([point(0, MissionItem.VehicleAction.TAKEOFF), point(12), point(24)])
    await mission.set_return_to_launch_after_mission(True)
    await mission.upload_mission(plan)
    await flight.action.arm()
    await mission.start_mission()
    progress = [await eventually(mission.mission_progress, lambda found: found.current >= 1)]
    assert progress[0].total == 3
    await eventually(mission.is_mission_finished, bool)
    await flight.said("start_mission completed")
    await eventually(flight.telemetry.armed, lambda armed: not armed)  # with the next heartbeat
    read = await mission.download_mission()
    assert [round(item.latitude_deg, 7) for item in read.mission_items] == [
        round(item.latitude_deg, 7) for item in plan.mission_items
    ]
    await mission.clear_mission()
    assert (await mission.download_mission()).mission_items == []
    flight.close()


async def test_mavsdks_raw_missions_and_fences_arrive_as_they_are(
    ground: Ground, mavsdk: Mavsdk, tmp_path: Path
) -> None:
    system = (await systems(mavsdk))[2]
    flight, mission, geofence = Flight(system), MissionRawAsync(system), GeofenceAsync(system)
    await eventually(flight.telemetry.health, lambda health: health.is_armable)
    items = [raw(0, TAKEOFF), raw(1, WAYPOINT), raw(2, WAYPOINT), back(3)]
    await mission.upload_mission(items)
    square = [Point(LATITUDE + north, LONGITUDE + east) for north, east in ((1, 1), (1, -1), (-1, -1), (-1, 1))]
    circle = Circle(Point(LATITUDE, LONGITUDE), 25.5, FenceType.EXCLUSION)
    await geofence.upload_geofence(GeofenceData([Polygon(square, FenceType.INCLUSION)], [circle]))
    await mission.upload_rally_points([raw(0, mavlink.MAV_CMD_NAV_RALLY_POINT, RALLY)])
    read = await mission.download_mission()
    assert [(one.seq, one.command, one.frame, one.x, one.y) for one in read] == [
        (one.seq, one.command, one.frame, one.x, one.y) for one in items
    ]
    await mission.set_current_mission_item(2)
    assert (await eventually(mission.mission_progress, lambda progress: progress.current == 2)).total == 4
    with pytest.raises(MissionRawError, match="INVALID_ARGUMENT"):
        await mission.upload_mission([raw(0, TAKEOFF), raw(1, WAYPOINT, x=97.0)])
    await flight.said("mission item 2: latitude: expected -90 to 90 degrees, got 97")
    with pytest.raises(MissionRawError, match="UNSUPPORTED"):
        await mission.upload_mission([raw(0, TAKEOFF), raw(1, WAYPOINT, frame=1)])
    assert str(downloaded(ground, tmp_path, 2)) == "4 mission items, 5 fence items, 1 rally points"
    flight.close()


def test_mavproxy_loads_lists_sets_and_clears(ground: Ground, tmp_path: Path) -> None:
    written = mavwp.MAVWPLoader()
    for seq, (command, frame) in enumerate(((TAKEOFF, 3), (WAYPOINT, 3), (RETURN, 2))):
        place = (LATITUDE + seq / 1e4, LONGITUDE, 10.0) if frame == 3 else (0, 0, 0)
        written.add(mavlink.MAVLink_mission_item_message(1, 1, seq, frame, command, 0, 1, 0, 0, 0, 0, *place, 0))
    path = tmp_path / "mission.txt"
    written.save(str(path))
    station = MavProxy(tmp_path, f"tcp:127.0.0.1:{ground.tcp}")
    try:
        station.choose(1, of={1, 2})
        station.type(f"wp load {path}")
        wait_until(lambda: "Sent all 3 waypoints" in station.said, "all are sent")
        wait_until(lambda: station.said.count(TAKEN) == 1, "the drone has them")
        station.type("wp list")
        wait_until(lambda: f"{RETURN} 2 " in station.said, "all are listed")
        station.type("wp set 1")
        wait_until(lambda: "DO_SET_MISSION_CURRENT: ACCEPTED" in station.said, "the second is the current one")
        station.type("wp clear")
        wait_until(lambda: station.said.count(TAKEN) == 2, "the drone has none")
        station.type("wp list")
        wait_until(lambda: "Requesting 0 waypoints" in station.said, "none are listed")
        assert str(downloaded(ground, tmp_path)) == "0 mission items, 0 fence items, 0 rally points"
    finally:
        station.close()


class Loader:
    """A pymavlink script: what mavwp has loaded is sent as it is asked for."""

    def __init__(self, client: Client, items: int, drone: int = 1) -> None:
        self.client, self.drone = client, drone
        self.plan = mavwp.MAVWPLoader(drone, 1)
        for seq in range(items):
            place = (LATITUDE + seq / 1e4, LONGITUDE, 10.0)
            command = WAYPOINT if seq else TAKEOFF
            self.plan.add(mavlink.MAVLink_mission_item_message(drone, 1, seq, 3, command, 0, 1, 0, 0, 0, 0, *place, 0))

    def upload(self, until: int | None = None) -> int | None:
        """The result; None where it broke off before item number `until`."""
        mav, seen = self.client.link.mav, len(self.client.messages)
        mav.mission_count_send(self.drone, 1, self.plan.count(), MISSION)
        while True:
            answer = self.client.until(_is_answer, "an answer", since=seen)
            if answer.get_type() == "MISSION_ACK":
                return int(answer.type)
            if answer.seq == until:
                return None
            seen = next(number for number, one in enumerate(self.client.messages) if one is answer) + 1
            mav.send(self.plan.wp(answer.seq))

    def download(self) -> mavwp.MAVWPLoader:
        mav, seen = self.client.link.mav, len(self.client.messages)
        mav.mission_request_list_send(self.drone, 1, MISSION)
        number = self.client.until(lambda message: message.get_type() == "MISSION_COUNT", "a count", since=seen).count
        read = mavwp.MAVWPLoader(self.drone, 1)
        for seq in range(number):
            mav.mission_request_send(self.drone, 1, seq, MISSION)
            read.add(
                self.client.until(
                    lambda message, seq=seq: message.get_type() == "MISSION_ITEM" and message.seq == seq, "an item"
                )
            )
        return read


def _is_answer(message: Any) -> bool:
    return message.get_type() in ("MISSION_REQUEST_INT", "MISSION_ACK")


def test_a_script_uploads_with_mavwp_and_one_that_breaks_off_leaves_the_old_plan(
    ground: Ground, client: Client, tmp_path: Path
) -> None:
    assert Loader(client, 100).upload() == 0
    for broken_at in (0, 1, 6):
        assert Loader(client, 7).upload(until=broken_at) is None
        client.text(f"broke off at item {broken_at + 1} of 7")
    assert Loader(client, 2001).upload() == mavlink.MAV_MISSION_NO_SPACE
    assert Loader(client, 0).download().count() == 100
    found = downloaded(ground, tmp_path).content
    wanted = [round((LATITUDE + seq / 1e4) * 1e7) for seq in range(100)]
    assert [item.x for item in found.mission or ()] == pytest.approx(wanted, abs=40)


def test_a_plan_that_the_drone_does_not_take_denies_the_arm_that_waited_for_it(ground: Ground, client: Client) -> None:
    """The drone is stalled until the plan was acknowledged; then its autopilot refuses an item."""
    assert Loader(client, 3).upload() == 0
    ground.uavs[1].stall()
    wrong = Loader(client, 3)
    wrong.plan.item(1).command = mavlink.MAV_CMD_DO_FENCE_ENABLE
    assert wrong.upload() == 0
    client.pump()
    seen = len(client.messages)
    client.link.mav.command_long_send(1, 1, 400, 0, 1, 0, *[NAN] * 5)
    client.until(lambda message: _acknowledges_arm(message, mavlink.MAV_RESULT_IN_PROGRESS), "it waits", since=seen)
    ground.uavs[1].go_on()
    client.until(lambda message: _acknowledges_arm(message, mavlink.MAV_RESULT_DENIED), "it is denied", 60, since=seen)
    client.until(lambda message: "mission item 2: " in getattr(message, "text", ""), "with the item", since=seen)
    assert ground.commanded(1, 400) == []
    assert Loader(client, 3).upload() == 0
    assert client.command(400, 1, 0, 0) == 0, "with another parameter: the same within a second is a repetition"


def _acknowledges_arm(message: Any, result: int) -> bool:
    return bool(message.get_type() == "COMMAND_ACK" and (message.command, message.result) == (400, result))


def test_a_station_without_the_right_uploads_nothing_to_a_fleet_that_signs(tmp_path: Path) -> None:
    system = SecureSystem(tmp_path, True, "--all-states")
    system.acme.issue("gs-plans", Rights(None, take_over=True, observe=True, upload_plan=True))
    system.let_in()
    with closing(system):
        system.start()
        with signing_client(system, "gs-ops") as client:
            assert Loader(client, 3).upload() == mavlink.MAV_MISSION_DENIED
            client.text("gs-ops's certificate has")
        with signing_client(system, "gs-plans") as client:
            assert Loader(client, 3).upload() == mavlink.MAV_MISSION_ACCEPTED
