"""What RabbitMQ 4 needs of a fleet: its users, and what each may publish and hear.

RabbitMQ names MQTT's topics in its own way: dots between the levels, `*` for `+`. It looks at what is published topic
by topic, and at a subscription by its filter. Its Erlang (OTP 27) cannot verify revocation lists that are signed by
Ed25519, so a revoked node is kept out by having no user.
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
"""A subscriber's queues, and the exchange that has all topics."""
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
    """Users without passwords, who log in by their certificates; deny by default, as Mosquitto's access list."""
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
    """A regular expression for all topics, and all narrower filters, that one of these covers."""
    found = [_expression(topic.split("/")) for topic in filters]
    return f"^({'|'.join(found)})$" if found else _NOTHING


def _expression(levels: list[str]) -> str:
    """A station asks for `commands_result/#`, which is one level: a last `+` below a name covers that too."""
    covering = [r"[^.#]+" if level == "+" else re.escape(level.replace(".", "/")) for level in levels]
    if levels[-1] == "+" and levels[-2] != "+":
        covering[-1] = r"[^.]+"
    return r"\.".join(covering)
