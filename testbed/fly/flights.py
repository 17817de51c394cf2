"""What an attempt is flown with: compose.yaml's variables, the mission's command line, what to type by hand."""

from __future__ import annotations

import os
import shlex
from collections.abc import Callable, Mapping
from pathlib import Path

from ..errors import UserError
from ..plan.experiments import Plan
from ..plan.overrides import chosen
from ..plan.sensors import sensor_settings, sensor_words
from ..plan.topology import FLEET

CLOUD_URL = "mqtt://198.18.1.3:1883"
CLOUD_HOST = CLOUD_URL.removeprefix("mqtt://").partition(":")[0]
STATION_HOST = "198.18.0.3"
FIRST_PORT = 14540
"""MAVSDK's port of a shared chain; that of drone N alone is N more."""
EVENTS = "/run-dir/events.jsonl"
ONE_UAV = {1: (1,)}
"""Whose messages the message set counts."""
CONTROL_DIR = "/run-dir/sitl"
SCENARIO_LIMIT_S = 1500.0
"""More than the limits of all steps of a scenario together: what takes longer hangs."""
MESSAGE_LIMIT_S = 300.0
"""The same for one message of each kind."""
LINK_BY_HAND = ".venv/bin/python -m testbed link air:uav3 --loss 20%"
LINKS_START = "/run-dir/links/start"
ENCODINGS = {"cbor": "", "json": "--json"}


def settings_of(plan: Plan, protocol: str, encoding: str = "cbor") -> dict[str, str]:
    """The environment that compose.yaml's variables take. Raises UserError for an unknown encoding or override.

    Without routers the autopilots talk to the ground station themselves; MQTT-XT's clients are beside them always.
    """
    if encoding not in ENCODINGS:
        raise UserError(f"ENCODING={encoding}: expected one of {', '.join(ENCODINGS)}")
    overlaid = chosen(os.environ)
    if plan.is_message_set and "AUTOPILOT" in overlaid:
        raise UserError(
            f"AUTOPILOT={overlaid['AUTOPILOT']}: expected none: only the stand-in can be put back each time"
        )
    alone = {"AUTOPILOT_ON": "0.0.0.0", "AUTOPILOT_TO": STATION_HOST}
    return {
        "QOS": str(plan.factors.qos),
        "STREAMS": plan.factors.streams,
        "CHAIN": plan.factors.chain,
        "ENCODING_FLAG": ENCODINGS[encoding],
        "BUNDLES_FLAG": "--bundles" if plan.factors.states == "bundle" else "",
        **overlaid,
        **(alone if protocol == "mavlink" and plan.factors.chain == "direct" else {}),
        **(sensor_settings(protocol, plan.samples) if plan.has_sensors else {}),
        **({"ONLY_FLAG": "--only 1", "CONTROL_DIR": CONTROL_DIR} if plan.is_message_set else {}),
    }


def profile_of(plan: Plan, protocol: str) -> str:
    """compose.yaml's profile that is flown with."""
    return f"{protocol}-one" if plan.is_message_set else protocol


def remove_sockets(attempt: Path) -> None:
    """A control socket that an autopilot left, because it was ended before it could clean up."""
    for path in (attempt / Path(CONTROL_DIR).name).glob("*.sock"):
        path.unlink(missing_ok=True)


def limit_s_of(plan: Plan) -> float:
    """How long a mission may take: a multiple of what it takes, so that only one that hangs is ended."""
    return SCENARIO_LIMIT_S + (MESSAGE_LIMIT_S * plan.count if plan.is_message_set else 0.0)


def mission_command(plan: Plan, protocol: str, events: str = EVENTS) -> list[str]:
    """What flies the plan's experiment over a protocol, run in the ground station's node."""
    flying = ONE_UAV if plan.is_message_set else FLEET
    fleet = ";".join(f"{fog}:{','.join(str(drone) for drone in drones)}" for fog, drones in flying.items())
    flown = plan.experiment if plan.mission is None else f"/run-dir/{plan.mission.name}"
    command = ["mission", "fly", flown, "--protocol", protocol, "--fleet", fleet, "--events", events]
    command += ["--links-start", LINKS_START] if events == EVENTS else []
    command += sensor_words(protocol, plan.samples) if plan.has_sensors else []
    command += ["--count", str(plan.count), "--control", f"{CONTROL_DIR}/uav1.sock"] if plan.is_message_set else []
    factors = plan.factors
    if protocol == "mavlink":
        urls = ",".join(mavlink_urls(factors.chain, flying))
        return [*command, "--mavlink", urls, "--streams", factors.streams, "--commanding", factors.commanding]
    return [*command, "--cloud", CLOUD_URL, "--qos", str(factors.qos), "--states", factors.states]


def mavlink_urls(chain: str, fleet: Mapping[int, tuple[int, ...]] = FLEET) -> tuple[str, ...]:
    """Where MAVSDK listens in the ground station's node: one port for all, or one for each drone in their order.

    The node's own routers reach it on loopback; without routers the autopilots send to the node's address.
    """
    drones = [drone for drones in fleet.values() for drone in drones]
    ports = [FIRST_PORT] if chain == "shared" else [FIRST_PORT + drone for drone in drones]
    host = "0.0.0.0" if chain == "direct" else "127.0.0.1"
    return tuple(f"udpin://{host}:{port}" for port in ports)


def by_hand(plan: Plan, protocol: str, name_of: Callable[[str], str]) -> str:
    """What to type to look at a fleet and to fly it; `name_of` tells the name of a service's container."""
    here = f"docker exec -it {name_of('gs')}"
    if protocol == "mavlink":
        return f"""\
Six drones are up, over MAVLink. To fly, and to look:
  {here} {shlex.join(mission_command(plan, protocol, "/tmp/events.jsonl"))}
  docker logs {name_of("router-fog1")}
  docker exec -it {name_of("net")} tcpdump -Z root -c 20 -nr /run-dir/pcap/uav1.pcap
  {LINK_BY_HAND}
  make down"""
    return f"""\
Six drones are up. To look and to fly:
  {here} mqttxt gs watch --fog 1 --fog 2
  {here} mqttxt gs send arm --fog 1 --drone 2
  {here} mqttxt gs send takeoff 10 --fog 1 --drone 2
  {here} mosquitto_sub -h {CLOUD_HOST} -v -t 'fog1/#'
  {LINK_BY_HAND}
  make down"""
