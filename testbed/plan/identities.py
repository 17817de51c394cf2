"""The identities of a fleet that flies with SECURITY=tls or signed. They are made for one flight, in its containers,
and vanish with them.
"""

from __future__ import annotations

from .fleet import Fleet

FOLDER = "/run/fleet/testbed"
"""The authority's folder, on an in-memory volume that all nodes share, with each node's identity in it."""
STATION = "ops"
PAGE = "page"
"""The name of the live page's station."""
_CLOUD = "/run/fleet/cloud"
_LISTEN = "0.0.0.0:8883"


def identity_of(name: str) -> str:
    """The folder of a node's identity."""
    return f"{FOLDER}/{name}"


def station_words(signed: bool) -> list[str]:
    """The ground station's options for its identity."""
    return ["--identity", identity_of(f"gs-{STATION}"), *(["--signed"] if signed else [])]


def client_words() -> str:
    """mosquitto's options for a client that is the ground station."""
    folder = identity_of(f"gs-{STATION}")
    return f"-p 8883 --cafile {folder}/fleet.pem --cert {folder}/certificate.pem --key {folder}/identity.pem"


def secured_settings(fleet: Fleet, *, signed: bool, sensors: bool) -> dict[str, str]:
    """The values of compose.yaml's variables with identities."""
    sign = " --signed" if signed else ""
    own = {f"FOG{fog}_AS": f"--identity {identity_of(f'fog{fog}')}{sign}" for fog in fleet.fogs}
    own |= {
        f"UAV{drone}_AS": f"--identity {identity_of(f'drone{drone}')}" + (f"{sign} --fog {fog}" if signed else "")
        for drone, fog in fleet.fog_of.items()
    }
    if sensors:
        own |= {f"SENSOR{drone}_AS": f"--identity {identity_of(f'sensor{drone}')}" for drone in fleet.fog_of}
    station = {"STATION_IDENTITY": identity_of(f"gs-{STATION}"), "SIGNED": "1" if signed else "0", "INSECURE": "0"}
    broker = {"BROKER_CONFIGURATION": f"{_CLOUD}/mosquitto.conf", "BROKER_CLIENT": client_words()}
    return {"MQTT": "mqtts", "MQTT_PORT": "8883", "AIR_SCHEME": "mqtts", "AIR_PORT": "8883", **broker, **station, **own}


def making(fleet: Fleet, *, sensors: bool, page: bool = False) -> list[list[str]]:
    """The commands that make the authority, an identity for each node, and the cloud broker's configuration."""
    drones = ",".join(map(str, fleet.fog_of))
    issued = [["broker", "cloud", "--address", fleet.address("cloud")]]
    issued += [["fog", str(fog), "--address", fleet.address(f"fog{fog}")] for fog in fleet.fogs]
    issued += [["drone", drones]]
    issued += [["station", STATION, "--may", "command", "--drones", "*", "--may", "take-over", "--may", "observe"]]
    if page:
        flies = ["--may", "command", "--drones", "*", "--may", "take-over", "--may", "upload-plan"]
        issued += [["station", PAGE, *flies, "--may", "observe"]]
    if sensors:
        issued += [["broker", f"drone{drone}", "--address", fleet.address(f"uav{drone}")] for drone in fleet.fog_of]
        issued += [["sensor", drones]]
    return [
        ["mqttxt", "keys", "init", "testbed", "--folder", FOLDER],
        *(["mqttxt", "keys", "issue", *words, "--fleet", FOLDER] for words in issued),
        ["mqttxt", "broker", "cloud", "--identity", identity_of("broker-cloud"), "--out", _CLOUD, "--listen", _LISTEN],
    ]
