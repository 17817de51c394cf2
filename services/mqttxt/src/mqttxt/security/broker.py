"""A broker's files: a Mosquitto configuration with mutual TLS 1.3, and the access list."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from ..errors import ConfigurationError
from . import files
from .access_list import Place, access_list
from .certificate import Certificate
from .fleet import FLEET_FILE, REVOKED_FILE
from .identity import CERTIFICATE_FILE, KEY_FILE, MEMBERS_FILE, Identity
from .names import Kind
from .revocation import RevocationList

CONFIGURATION_FILE, ACCESS_FILE = "mosquitto.conf", "access.acl"
MOST_CONNECTIONS = 2000
"""Connections at a listener: two for each of a thousand nodes, while they reconnect over another network."""
LIMITS = """\
# Without persistence on purpose: a retained record of a drone that died with the broker would stay for good.
persistence false
set_tcp_nodelay true
max_packet_size 65536
# The longest payload (R3.4).
message_size_limit 61440
# The default, 20 unacknowledged messages a connection, would hold back broadcasts on slow links.
max_inflight_messages 1000
max_queued_messages 1000
# No longer than a drone's session of readings (R9.11), whatever a client asks for.
persistent_client_expiration 1h
log_dest stderr
log_type error
log_type warning
log_type notice
# Among these is the line by which it is known to run.
log_type information
connection_messages true
"""
"""The settings of each of our brokers, with identities or without."""
ALIASES = """\
# A topic for each state of 250 drones and more: one connection, the activator's, may publish them all.
max_topic_alias 4096
"""
"""The settings of the listener: before a `listener` line Mosquitto applies them to another one."""
_CONFIGURATION = """\
# Made by `mqttxt broker`: make it again instead of changing it.
{limits}\
# For one client that takes nothing 16 MB are kept.
max_queued_bytes 16777216
{user}\
listener {port} {host}
max_connections {connections}
{aliases}\
allow_anonymous false
require_certificate true
use_identity_as_username true
tls_version tlsv1.3
cafile {fleet}
certfile {certificate}
keyfile {key}
crlfile {revoked}
acl_file {access}
"""


class BrokerFiles:
    """Makes a broker's files from its identity; raises ConfigurationError if the identity is not a broker's.

    Nothing is copied: the configuration names the identity's own files, so that a renewed list takes effect at SIGHUP.
    `fogs` share the cloud's broker. `air`: it is a fog's broker, whose drones connect through the activator.
    """

    def __init__(
        self,
        folder: Path,
        prefix: str = "",
        system: Callable[[], float] = time.time,
        fogs: frozenset[int] = frozenset(),
        air: bool = False,
    ) -> None:
        self.identity = Identity.load(folder, system)
        if self.identity.certificate.node.kind is not Kind.BROKER:
            raise ConfigurationError(f"{folder}: the identity of {self.identity.name}; expected a broker's")
        self.place = replace(Place.of_broker(self.identity.certificate.node, prefix, fogs), air=air)
        self._served = {each.serial: each.name for each in self.members()}

    def members(self) -> list[Certificate]:
        """The members that may use the broker: by certificates of this fleet, not revoked, and valid now or later."""
        path = self.identity.folder / MEMBERS_FILE
        fleet, now_s = self.identity.fleet, self.identity.time.now_s()
        found = Certificate.all_from_pem(files.read(path), str(path))
        verdicts = [fleet.verify(each, now_s) for each in found]
        if "other_fleet" in verdicts:
            name = found[verdicts.index("other_fleet")].name
            raise ConfigurationError(f"{path}: {name}: not issued by the authority in {FLEET_FILE}")
        return [each for each, wrong in zip(found, verdicts, strict=True) if wrong in (None, "not_yet_valid")]

    def fogs(self) -> set[int]:
        """The numbers of the fleet's fogs."""
        return {each.node.number for each in self.members() if each.node.kind is Kind.FOG}

    def write(self, out: Path, host: str, port: int, newest: RevocationList | None = None) -> Path:
        """Write configuration and access list into a folder; returns the configuration's path.

        `newest` as for `write_access`.
        """
        folder, access = self.identity.folder.resolve(), (out / ACCESS_FILE).resolve()
        for path in (folder, access):
            if not str(path).isprintable():
                raise ConfigurationError(f"{str(path)!r}: {CONFIGURATION_FILE} names it; expected printable characters")
        with files.changing(out):
            out.mkdir(parents=True, exist_ok=True)
        self.write_access(out, newest)
        text = _CONFIGURATION.format(
            limits=LIMITS,
            connections=MOST_CONNECTIONS,
            aliases=ALIASES,
            user=_user_of(folder / KEY_FILE),
            host=host,
            port=port,
            fleet=folder / FLEET_FILE,
            certificate=folder / CERTIFICATE_FILE,
            key=folder / KEY_FILE,
            revoked=folder / REVOKED_FILE,
            access=access,
        )
        files.write(out / CONFIGURATION_FILE, text.encode())
        return out / CONFIGURATION_FILE

    def write_access(self, out: Path, newest: RevocationList | None = None) -> None:
        """Write the access list again, for the present members; raises ConfigurationError for a bad file.

        `newest` is the newest revocation list of the broker's node; the broker's folder gets it too.
        """
        fleet = self.identity.fleet
        if newest is not None:
            fleet.take(newest)
        with contextlib.ExitStack() as whatever_is_wrong:
            whatever_is_wrong.callback(self._write_members, out)
            whatever_is_wrong.callback(fleet.keep)
            fleet.take(fleet.in_folder())

    def take_outlived(self) -> set[str]:
        """Names in use that had a certificate revoked since the broker's start, or since the last call.

        Their entries stay, and so does the connection with the revoked certificate.
        """
        revoked = self._served.keys() & self.identity.fleet.revoked.serials
        in_use = {name for serial, name in self._served.items() if serial not in revoked}
        taken = {serial for serial in revoked if self._served[serial] in in_use}
        return {self._served.pop(serial) for serial in taken}

    @property
    def is_list_readable(self) -> bool:
        """Whether Mosquitto can read the revocation list: without one it would accept everyone."""
        try:
            self.identity.fleet.in_folder()
        except ConfigurationError:
            return False
        return True

    def _write_members(self, out: Path) -> None:
        members = self.members()
        found = access_list(self.place, members).encode()
        # Readable only for users who may read the key: Mosquitto will refuse other lists one day.
        files.write(out / ACCESS_FILE, found, 0o600, like=self.identity.folder / KEY_FILE)
        self._served |= {each.serial: each.name for each in members}


def _user_of(key: Path) -> str:
    """The `user` line: Mosquitto started by root becomes the key's owner before it reads the key.

    On Windows it keeps its user.
    """
    with contextlib.suppress(KeyError, NotImplementedError):
        return f"user {key.owner()}\n"
    return ""
