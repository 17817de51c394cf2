"""Finds every mistake in an identity's folder, for `mqttxt keys check`."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from ..errors import ConfigurationError
from .broker import BrokerFiles
from .files import is_folder
from .fleet import Fleet
from .identity import CERTIFICATE_FILE, KEY_FILE, check_pair, check_valid, read_certificate, read_key
from .names import Kind
from .trusted_time import TrustedTime

T = TypeVar("T")


def problems(folder: Path, system: Callable[[], float] = time.time) -> list[str]:
    """A line for each mistake; none if a node would start with the folder."""
    found: list[str] = []

    def tried(step: Callable[[], T]) -> T | None:
        try:
            return step()
        except ConfigurationError as error:
            if str(error) not in found:
                found.append(str(error))
            return None

    if not is_folder(folder, f"identity {folder}"):
        return [f"identity {folder}: no such folder; expected one of `mqttxt keys issue`"]
    key = tried(lambda: read_key(folder / KEY_FILE))
    certificate = tried(lambda: read_certificate(folder / CERTIFICATE_FILE))
    fleet = tried(lambda: Fleet.load(folder))
    if key is not None and certificate is not None:
        tried(lambda: check_pair(folder, key, certificate))
    if fleet is not None:
        now = tried(lambda: TrustedTime(folder, fleet, system))
        if certificate is not None and now is not None:
            tried(lambda: check_valid(folder, certificate, now))
    if certificate is not None and certificate.node.kind is Kind.BROKER and not found:
        tried(lambda: BrokerFiles(folder, system=system))
    return found
