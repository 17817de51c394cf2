"""The definitions of a fleet for RabbitMQ 4: its users, and the topics that each may publish and receive.

RabbitMQ writes MQTT's topics with dots between the levels, and `*` for `+`. It checks each published topic, and each
subscription by its filter. Its Erlang (OTP 27) cannot verify revocation lists that are signed by Ed25519, so a revoked
node is kept out by having no user.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from ..errors import ConfigurationError
from . import files
from .access_list import entries_of_all
from .broker import BrokerFiles
from .identity import KEY_FILE

DEFINITIONS_FILE = "definitions.json"
EXCHANGE = "amq.topic"
_OWN = r"^(mqtt-subscription-.*|amq\.topic)$"
"""A subscriber's queues, and the exchange of all topics."""
_NOTHING = "^$"


def write(broker: BrokerFiles, out: Path) -> Path:
    """Write the definitions into a folder; returns their path. Raises ConfigurationError."""
    if broker.place.fogs:
        raise ConfigurationError("--fogs: RabbitMQ is no fog's broker; expected none")
    with files.changing(out):
        out.mkdir(parents=True, exist_ok=True)
    path = out / DEFINITIONS_FILE
    files.write(path, json.dumps(definitions(broker), indent=1).encode(), 0o600, like=broker.identity.folder / KEY_FILE)
    return path


def definitions(broker: BrokerFiles) -> dict[str, Any]:
    """Users without passwords, who log in by certificate; deny by default, as in Mosquitto's access list."""
    given = list(entries_of_all(broker.place, broker.members()))
    return {
        "vhosts": [{"name": "/"}],
        "users": [{"name": str(node), "password_hash": "", "tags": []} for node, _ in given],
        "permissions": [
            {"user": str(node), "vhost": "/", "configure": _OWN, "write": _OWN, "read": _OWN} for node, _ in given
        ],
        "topic_permissions": [
            {
                "user": str(node),
                "vhost": "/",
                "exchange": EXCHANGE,
                "write": _any(entry.filter for entry in entries if entry.publish),
                "read": _any(entry.filter for entry in entries if entry.hear),
            }
            for node, entries in given
        ],
    }


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
