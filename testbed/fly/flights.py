"""The settings of an attempt: compose.yaml's variables, the mission's command line, and commands to type by hand."""

from __future__ import annotations

import os
import shlex
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

from ..errors import UserError
from ..plan import wording
from ..plan.experiments import Plan
from ..plan.fleet import FIRST_PORT
from ..plan.fleets import standard_fleet
from ..plan.identities import client_words, secured_settings, station_words
from ..plan.overrides import FLEET_COPY, chosen
from ..plan.sensors import sensor_settings, sensor_words
from .results import KEY_LOG

EVENTS = "/run-dir/events.jsonl"
CONTROL_DIR = "/run-dir/sitl"
LINKS_START = "/run-dir/links/start"
SN, AIR_PORT = "mqtt-sn", "1883"
"""The scheme and UDP port by which UAV clients reach their fogs with datagrams."""
ENCODINGS = {"cbor": "", "json": "--json"}


def settings_of(plan: Plan, protocol: str, encoding: str = "cbor") -> dict[str, str]:
    """The values of compose.yaml's variables. Raises UserError for an unknown encoding or override.

    Without routers the autopilots send directly to the ground station; MQTT-XT's clients always run beside them.
    """
    if encoding not in ENCODINGS:
        raise UserError(f"ENCODING={encoding}: expected one of {', '.join(ENCODINGS)}")
    overlaid = chosen(os.environ)
    alone = {"AUTOPILOT_ON": "0.0.0.0", "AUTOPILOT_TO": plan.fleet.address("gs")}
    secured = plan.is_secured(protocol)
    by_air = protocol == "mqttxt" and plan.factors.air == "sn"
    return {
        "QOS": str(plan.factors.qos),
        "STREAMS": plan.factors.streams,
        "CHAIN": plan.factors.chain,
        "TCP_TIMESTAMPS": "0" if plan.factors.tcp == "lean" else "1",
        "ENCODING_FLAG": ENCODINGS[encoding],
        "BUNDLES_FLAG": "--bundles" if plan.factors.states == "bundle" else "",
        "ALL_STATES_FLAG": "--all-states" if plan.through_gateway(protocol) else "",
        **overlaid,
        **(alone if protocol == "mavlink" and plan.factors.chain == "direct" else {}),
        **(sensor_settings(plan.fleet, protocol, plan.samples, secured=secured) if plan.has_sensors else {}),
        **(secured_settings(plan.fleet, signed=plan.is_signed, sensors=plan.has_sensors) if secured else {}),
        **({"AIR_SCHEME": SN, "AIR_PORT": AIR_PORT, "AIR_FLAG": f"--air-sn 0.0.0.0:{AIR_PORT}"} if by_air else {}),
        **({"TLS_KEYS": f"/run-dir/{KEY_LOG}"} if secured else {}),
        **({"ONLY_FLAG": f"--only {_one(plan)}", "CONTROL_DIR": CONTROL_DIR} if plan.is_message_set else {}),
        **({"FLEET_FILE": f"/run-dir/{FLEET_COPY}"} if plan.fleet != standard_fleet() else {}),
    }


def check_settings(plans: Iterable[Plan]) -> None:
    """Raise UserError as `settings_of` for any of the plans, before anything is written."""
    for plan in plans:
        for protocol in plan.protocols:
            settings_of(plan, protocol)


def _one(plan: Plan) -> int:
    """The drone whose messages the message set counts."""
    ((drone,),) = plan.fleet.one.values()
    return drone


def profile_of(plan: Plan, protocol: str) -> str:
    """The profile of compose.yaml to start."""
    return f"{protocol}-one" if plan.is_message_set else protocol


def remove_sockets(attempt: Path) -> None:
    """Remove the control sockets of autopilots that were ended before they could clean up."""
    for path in (attempt / Path(CONTROL_DIR).name).glob("*.sock"):
        path.unlink(missing_ok=True)


def mission_command(plan: Plan, protocol: str, events: str = EVENTS) -> list[str]:
    """The command that flies the plan's experiment over a protocol, for the ground station's node."""
    flying = replace(plan.fleet, fogs=plan.fleet.one) if plan.is_message_set else plan.fleet
    flown = plan.experiment if plan.mission is None else f"/run-dir/{plan.mission.name}"
    command = ["mission", "fly", flown, "--protocol", protocol, "--fleet", flying.flown, "--events", events]
    command += ["--links-start", LINKS_START] if events == EVENTS else []
    command += sensor_words(plan.fleet, protocol, plan.samples) if plan.has_sensors else []
    if plan.is_message_set:
        command += ["--count", str(plan.count), "--control", f"{CONTROL_DIR}/uav{_one(plan)}.sock"]
    factors = plan.factors
    if protocol == "mavlink":
        urls = ",".join(mavlink_urls(factors.chain, flying.fog_of))
        return [*command, "--mavlink", urls, "--streams", factors.streams, "--commanding", factors.commanding]
    secured = plan.is_secured(protocol)
    command += [
        "--cloud",
        plan.fleet.broker_url("cloud", secured=secured),
        *(station_words(plan.is_signed) if secured else []),
    ]
    command += ["--qos", str(factors.qos), "--states", factors.states]
    return [*command, "--gateway", "--commanding", factors.commanding] if plan.through_gateway(protocol) else command


def mavlink_urls(chain: str, drones: Iterable[int]) -> tuple[str, ...]:
    """Where MAVSDK listens in the ground station's node: one port for all drones, or one for each in order.

    The node's own routers reach it on loopback; without routers the autopilots send to the node's address.
    """
    ports = [FIRST_PORT] if chain == "shared" else [FIRST_PORT + drone for drone in drones]
    host = "0.0.0.0" if chain == "direct" else "127.0.0.1"
    return tuple(f"udpin://{host}:{port}" for port in ports)


def by_hand(plan: Plan, protocol: str, name_of: Callable[[str], str]) -> str:
    """The commands to watch and fly a fleet by hand; `name_of` returns the name of a service's container."""
    here = f"docker exec -it {name_of('gs')}"
    drones = wording.plural(len(plan.fleet.fog_of), "drone")
    fog, drone, fogs = next(iter(plan.fleet.fogs)), _one(plan), " ".join(f"--fog {fog}" for fog in plan.fleet.fogs)
    link = f".venv/bin/python -m testbed link air:uav{drone} --loss 20%"
    if protocol == "mavlink":
        return f"""\
{drones} up, over MAVLink. To fly, and to look:
  {here} {shlex.join(mission_command(plan, protocol, "/tmp/events.jsonl"))}
  docker logs {name_of("router-cloud")}
  docker exec -it {name_of("net")} tcpdump -Z root -c 20 -nr /run-dir/pcap/uav{drone}.pcap
  {link}
  make down"""
    client = f" {client_words()}" if plan.is_secured(protocol) else ""
    return f"""\
{drones} up. To look and to fly beside the page, which has control until then, and again afterwards:
  {here} mqttxt gs watch {fogs}
  {here} mqttxt gs send arm --fog {fog} --drone {drone} --take-over
  {here} mqttxt gs send takeoff 10 --fog {fog} --drone {drone} --take-over
  {here} mosquitto_sub -h {plan.fleet.address("cloud")}{client} -v -t 'fog{fog}/#'
  {link}
  make down"""
