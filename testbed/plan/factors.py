"""The factors of an experiment: how a fleet communicates over each protocol, and what each value means."""

from __future__ import annotations

from dataclasses import dataclass, fields

_READ_BY_KEYS = (
    "captures are of encrypted traffic, whose bytes all count; topics, losses and delays by capture are read with the "
    "session keys that each node wrote down (tls/keys.log), and without one of these there are no numbers"
)
MEANINGS: dict[str, dict[str, dict[str, str]]] = {
    "mqttxt": {
        "states": {
            "on-change": "a drone publishes a state when it changes",
            "fixed": "a drone publishes each state once per second, each in a message of its own",
            "bundle": "a drone publishes its states once per second, all in one message",
        },
        "qos": {
            "0": "commands, results and states go at QoS 0, without MQTT's acknowledgements",
            "1": "commands, results and states go at QoS 1: each is acknowledged on every hop",
        },
        "security": {
            "none": "nothing is encrypted or signed, and the nodes have no identities",
            "tls": f"every connection is mutual TLS 1.3, with identities made for the flight; {_READ_BY_KEYS}",
            "signed": f"commands, words, beacons and leases are signed end to end, in mutual TLS 1.3; {_READ_BY_KEYS}",
        },
        "station": {
            "mqttxt": "the ground station is a program on MQTT-XT's own API",
            "mavsdk": "the ground station is MAVSDK, as over MAVLink, through `mqttxt gs mavlink` beside it",
        },
        "tcp": {
            "default": "TCP is as Linux has it, with time stamps: 12 bytes of each frame",
            "lean": "TCP has no time stamps",
        },
        "air": {
            "tcp": "drones reach their fogs by MQTT over TCP",
            "sn": "drones reach their fogs by MQTT-SN over UDP: a lost state is replaced by the next, not repeated",
        },
    },
    "mavlink": {
        "streams": {
            "px4-onboard": "every drone streams PX4's onboard set, all of it to the ground station",
            "px4-gcs": "every drone streams PX4's ground-station set",
            "five-states": "every drone streams the five states that were asked for, at 1 Hz",
        },
        "commanding": {
            "one-by-one": "one call at a time: the next begins when the last has returned",
            "concurrent": "all drones are called at once",
        },
        "chain": {
            "per-uav": "each drone has routers of its own on every node of its way",
            "shared": "one router a node, for all drones together",
            "direct": "no routers: datagrams are forwarded by IP over the same links",
        },
    },
}
"""What a value means, by the protocol that it is for, factor and value; reports have the factors in this order."""


@dataclass(frozen=True)
class Factors:
    """A value of each factor, as in `MEANINGS`."""

    streams: str
    commanding: str
    qos: int
    chain: str
    states: str
    security: str = "none"
    station: str = "mqttxt"
    tcp: str = "default"
    air: str = "tcp"


_VALUES = MEANINGS["mqttxt"] | MEANINGS["mavlink"]
FACTORS: dict[str, tuple[str, ...]] = {factor.name: tuple(_VALUES[factor.name]) for factor in fields(Factors)}
"""Every factor with its values; its name in capitals is the variable that sets it."""
