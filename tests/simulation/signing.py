"""A fleet whose nodes sign: identities that are made once, and a seal of its own for each role of a test."""

from __future__ import annotations

import atexit
import shutil
import tempfile
from functools import cache
from pathlib import Path

from mqttxt.security.authority import Authority
from mqttxt.security.identity import Identity
from mqttxt.security.rights import Rights
from mqttxt.security.seal import Seal

ALL = Rights(command=None, take_over=True, upload_plan=True, set_parameters=True)


@cache
def authority(fleet: str = "acme") -> Authority:
    folder = Path(tempfile.mkdtemp(prefix="mqttxt-fleet-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Authority.create(folder / fleet, fleet)


@cache
def folder(name: str, rights: Rights, fleet: str) -> Path:
    return authority(fleet).issue(name, rights)


def seal(name: str, rights: Rights | None = None, fleet: str = "acme") -> Seal:
    """A node's seal, without others' certificates yet. A station has all rights unless `rights` are given."""
    default = ALL if name.startswith("gs-") else Rights()
    return Seal(Identity.load(folder(name, default if rights is None else rights, fleet)))
