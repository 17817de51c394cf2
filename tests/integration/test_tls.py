"""A ground station at a real Mosquitto that talks TLS, with a certificate authority made here."""

from __future__ import annotations

import ssl
import subprocess
from pathlib import Path

import pytest

from mqttxt import FogUnreachable, GroundStation
from tests.rigs.processes import System, eventually, free_port

pytestmark = pytest.mark.integration


def certify(folder: Path, name: str, subject: str, *more: str) -> None:
    """A key and its certificate, by the authority `ca` where `more` says so."""
    command = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
    files = ["-keyout", f"{name}.key", "-out", f"{name}.pem"]
    subprocess.run([*command, "-days", "2", "-subj", subject, *more, *files], cwd=folder, check=True, timeout=30)
    (folder / f"{name}.key").chmod(0o644)  # Mosquitto runs as another user


async def test_a_drone_is_armed_over_tls_by_whom_the_authority_vouches_for(tmp_path: Path) -> None:
    by_authority = ("-CA", "ca.pem", "-CAkey", "ca.key")
    certify(tmp_path, "ca", "/CN=authority")
    certify(tmp_path, "broker", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost", *by_authority)
    certify(tmp_path, "station", "/CN=station", *by_authority)
    system = System(tmp_path)
    port = free_port()
    with system.cloud.configuration.open("a") as configuration:
        configuration.write(f"listener {port} 127.0.0.1\nrequire_certificate true\n")
        for option, file in (("cafile", "ca.pem"), ("certfile", "broker.pem"), ("keyfile", "broker.key")):
            configuration.write(f"{option} {tmp_path / file}\n")
    url = f"mqtts://localhost:{port}"
    unknown = ssl.create_default_context(cafile=str(tmp_path / "ca.pem"))
    known = ssl.create_default_context(cafile=str(tmp_path / "ca.pem"))
    known.load_cert_chain(tmp_path / "station.pem", tmp_path / "station.key")
    try:
        system.start()
        async with GroundStation(url, ssl_context=known) as station:
            (fog,) = await station.connect([1])
            await eventually(lambda: fog.drone(1).is_reachable, "drone 1 is reachable")
            assert (await fog.drone(1).arm()).completed
        async with GroundStation(url) as station:
            with pytest.raises(FogUnreachable, match=rf"no connection to {url} \(.*certificate verify failed"):
                await station.connect([1], timeout_s=3)
        async with GroundStation(url, ssl_context=unknown) as station:
            with pytest.raises(FogUnreachable, match=rf"no connection to {url} \("):
                await station.connect([1], timeout_s=3)
    finally:
        system.close()
