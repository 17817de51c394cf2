"""The definitions of fleets for RabbitMQ 4: their users, and the topics that each may publish and receive.

Each fleet has a virtual host, by its name, and a port whose clients RabbitMQ takes there. A user is a name in
certificates; it has rights only in the virtual hosts of fleets that have such a member.
RabbitMQ writes MQTT's topics with dots between the levels, and `*` for `+`. It checks each published topic, and each
subscription by its filter. Its Erlang (OTP 27) cannot verify revocation lists that are signed by Ed25519, so a revoked
node is kept out by having no permissions.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from ..errors import ConfigurationError
from ..protocol.names import NAME, NAME_EXPECTED
from . import files
from .access_list import entries_of_all
from .broker import BrokerFiles
from .fleet import FLEET_FILE
from .identity import CERTIFICATE_FILE, KEY_FILE

DEFINITIONS_FILE, FLEETS = "definitions.json", "fleets"
EXCHANGE = "amq.topic"
PORTS = "mqtt_port_to_vhost_mapping"
"""RabbitMQ's parameter of the fleets' ports."""
_OWN = r"^(mqtt-subscription-.*|amq\.topic)$"
"""A subscriber's queues, and the exchange of all topics."""
_NOTHING = "^$"


def write(broker: BrokerFiles, out: Path, port: int) -> Path:
    """Write a fleet and its port into a cluster's folder; returns the definitions' path. Raises ConfigurationError.

    `fleets/NAME` gets the fleet's own part, and a copy of the broker's identity, with which the nodes listen. The
    definitions are those of all fleets that have such a folder.
    """
    if broker.place.fogs:
        raise ConfigurationError("--fogs: RabbitMQ is no fog's broker; expected none")
    fleet, source = broker.identity.fleet.name, broker.identity.folder
    if not re.fullmatch(NAME, fleet) or not fleet.strip("."):
        raise ConfigurationError(f"fleet name {fleet[:80]!r}: expected {NAME_EXPECTED}, and more than dots")
    folder = out / FLEETS / fleet
    with files.changing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    with files.locked(out):
        known = folder / FLEET_FILE
        if known.exists() and files.read(known) != files.read(source / FLEET_FILE):
            raise ConfigurationError(f"{known}: another authority of that name; expected a name for each fleet")
        parts = {path: _read(path) for path in (out / FLEETS).glob(f"*/{DEFINITIONS_FILE}")}
        parts[folder / DEFINITIONS_FILE] = own = definitions(broker, port)
        whole = together([parts[path] for path in sorted(parts)])
        for name, mode in ((FLEET_FILE, 0o644), (CERTIFICATE_FILE, 0o644), (KEY_FILE, 0o600)):
            files.write(folder / name, files.read(source / name), mode, like=source / KEY_FILE)
        for path, found in ((folder / DEFINITIONS_FILE, own), (out / DEFINITIONS_FILE, whole)):
            files.write(path, json.dumps(found, indent=1).encode(), 0o600, like=source / KEY_FILE)
    return out / DEFINITIONS_FILE


def definitions(broker: BrokerFiles, port: int) -> dict[str, Any]:
    """A fleet's users, without passwords, who log in by certificate; deny by default, as in Mosquitto's access list."""
    fleet, given = broker.identity.fleet.name, list(entries_of_all(broker.place, broker.members()))
    return {
        "vhosts": [{"name": fleet}],
        "users": [{"name": str(node), "password_hash": "", "tags": []} for node, _ in given],
        "permissions": [
            {"user": str(node), "vhost": fleet, "configure": _OWN, "write": _OWN, "read": _OWN} for node, _ in given
        ],
        "topic_permissions": [
            {
                "user": str(node),
                "vhost": fleet,
                "exchange": EXCHANGE,
                "write": _any(entry.filter for entry in entries if entry.publish),
                "read": _any(entry.filter for entry in entries if entry.hear),
            }
            for node, entries in given
        ],
        "global_parameters": [{"name": PORTS, "value": {str(port): fleet}}],
    }


def together(parts: Iterable[dict[str, Any]]) -> dict[str, Any]:
    """The definitions of several fleets as one; raises ConfigurationError if two have the same port."""
    found: dict[str, Any] = {}
    users: dict[str, Any] = {}
    ports: dict[str, str] = {}
    for part in parts:
        for kind in ("vhosts", "permissions", "topic_permissions"):
            found.setdefault(kind, []).extend(part[kind])
        users |= {user["name"]: user for user in part["users"]}
        for port, fleet in part["global_parameters"][0]["value"].items():
            if port in ports:
                raise ConfigurationError(f"--listen: fleets {ports[port]} and {fleet} at port {port}; expected one")
            ports[port] = fleet
    return found | {"users": list(users.values()), "global_parameters": [{"name": PORTS, "value": ports}]}


def _read(path: Path) -> dict[str, Any]:
    try:
        found: dict[str, Any] = json.loads(files.read(path))
    except ValueError as error:
        raise ConfigurationError(f"{path}: {error}; expected what `mqttxt broker` wrote") from error
    return found


def _any(filters: Iterable[str]) -> str:
    """A regular expression for all topics, and all narrower filters, that `filters` cover."""
    found = [_expression(topic.split("/")) for topic in filters]
    return f"^({'|'.join(found)})$" if found else _NOTHING


def _expression(levels: list[str]) -> str:
    """One filter's expression. A last `+` after a name covers `#` too: stations subscribe to `commands_result/#`."""
    covering = [r"[^.#]+" if level == "+" else re.escape(level.replace(".", "/")) for level in levels]
    if levels[-1] == "+" and levels[-2] != "+":
        covering[-1] = r"[^.]+"
    return r"\.".join(covering)
