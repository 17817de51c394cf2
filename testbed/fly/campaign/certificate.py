"""The campaign's certificate: one file on all its machines, with which scheduler and workers authenticate each other.

It is a secret: anyone who has it can run any program on these machines.
"""

from __future__ import annotations

import asyncio
import os
import re
import ssl
from datetime import UTC, datetime
from pathlib import Path

from cryptography import x509
from distributed import Security
from distributed.comm.core import connect

from ...errors import UserError

ANSWERS_S = 5.0
_ADDRESS = re.compile(r"tls://(\[[0-9a-fA-F:]+\]|[A-Za-z0-9._-]+):\d{1,5}")


def make_certificate(path: Path) -> None:
    """Write key and certificate, valid for a year, into a new file that only its owner can read."""
    made = Security.temporary()
    try:
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except OSError as error:
        raise UserError(f"{path}: {error.strerror}; expected a new file for the campaign's certificate") from error
    with open(handle, "w", encoding="ascii") as out:
        out.write(f"{made.tls_client_key}{made.tls_client_cert}")


def security_of(path: Path) -> Security:
    """Dask's TLS with a campaign's certificate, for every role. Raises UserError if the file is not such, is readable
    by others, or has expired."""
    expected = "expected the campaign's certificate, as `make certificate` makes it; the same on every machine"
    try:
        text = path.read_bytes()
        if path.stat().st_mode & 0o077:
            raise UserError(f"{path}: others can read it; type: chmod 600 {path}")
        ssl.create_default_context().load_cert_chain(path)
        ends = x509.load_pem_x509_certificate(text).not_valid_after_utc
    except (OSError, ValueError) as error:  # an SSLError is an OSError
        said = "no certificate with its key" if isinstance(error, ssl.SSLError | ValueError) else error.strerror
        raise UserError(f"{path}: {said}; {expected}") from error
    if ends < datetime.now(UTC):
        raise UserError(f"{path}: expired at {ends:%Y-%m-%d}; remove it, and type: make certificate")
    roles = {f"tls_{role}_{part}": str(path) for role in ("client", "scheduler", "worker") for part in ("cert", "key")}
    return Security(require_encryption=True, tls_ca_file=str(path), tls_min_version=ssl.TLSVersion.TLSv1_3, **roles)


def check_scheduler(address: str, security: Security) -> None:
    """Raise UserError if no scheduler with this certificate answers at the address."""
    if not _ADDRESS.fullmatch(address):
        raise UserError(f"SCHEDULER={address}: expected tls://HOST:PORT, as `make scheduler` prints it")
    try:
        asyncio.run(_greet(address, security))
    except OSError as error:
        raise UserError(f"SCHEDULER={address}: {_why(error)}") from error


async def _greet(address: str, security: Security) -> None:
    comm = await connect(address, timeout=ANSWERS_S, **security.get_connection_args("client"))
    await comm.close()


def _why(error: BaseException | None) -> str:
    while error is not None:
        if isinstance(error, ssl.SSLError):
            return "it has another certificate; expected the same file on every machine"
        error = error.__cause__ or error.__context__
    return "no scheduler answers; expected one that `make scheduler` started"
