"""Certificates that the other side refuses, at a real Mosquitto: a node's by the broker, a broker's by the node.

The certificate is wrong, the node does not look at its own, and one line says why the connection does not come about.
"""

from __future__ import annotations

import asyncio
import shutil
import subprocess
from collections.abc import Callable
from contextlib import ExitStack
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from mqttxt.core.address import BrokerAddress
from mqttxt.core.mqtt.link import MqttLink
from mqttxt.security.authority import Authority
from mqttxt.security.fleet import Fleet
from mqttxt.security.identity import Identity, read_certificate, read_key
from mqttxt.security.trusted_time import TrustedTime
from tests.rigs.linked import Heard
from tests.rigs.processes import eventually
from tests.rigs.secure import SecureBroker

pytestmark = [pytest.mark.integration, pytest.mark.apart]

AGO, LATER = timedelta(days=-2), timedelta(days=1)


def as_it_is(folder: Path, system: Callable[[], float] | None = None) -> Identity:
    """An identity that does not look at itself."""
    fleet = Fleet.load(folder)
    own_time = TrustedTime(folder, fleet, system) if system is not None else TrustedTime(folder, fleet)
    key, certificate = read_key(folder / "identity.pem"), read_certificate(folder / "certificate.pem")
    return Identity(folder, key, certificate, fleet, own_time)


async def outcome(identity: Identity, address: BrokerAddress) -> str | None:
    """Why a connection does not come about, None where it does."""
    events = Heard()
    link = MqttLink("cloud", address, "someone", None, events, identity=identity)
    running = asyncio.create_task(link.run())
    try:
        await eventually(lambda: events.connections > 0 or link.failure is not None, "an outcome")
    finally:
        await link.close()
        running.cancel()
        await asyncio.wait({running})
    return link.failure if not events.connections else None


@pytest.fixture(scope="module")
def acme(tmp_path_factory: pytest.TempPathFactory) -> Authority:
    authority = Authority.create(tmp_path_factory.mktemp("fleet") / "acme", "acme")
    authority.issue("broker-cloud")
    authority.issue("drone1")
    authority.issue("drone2", days=1, not_before=datetime.now(UTC) + AGO)
    authority.issue("drone3", not_before=datetime.now(UTC) + LATER)
    authority.issue("drone4")
    authority.revoke("drone4")
    return authority


@pytest.fixture(scope="module")
def theirs(acme: Authority) -> Authority:
    """Another fleet of the same name."""
    authority = Authority.create(acme.folder.parent / "theirs", "acme")
    for name in ("drone1", "broker-cloud"):
        authority.issue(name)
    return authority


_SELF_SIGNED = """\
[req]
distinguished_name = nobody
x509_extensions = own
[nobody]
[own]
basicConstraints = critical, CA:FALSE
extendedKeyUsage = {usage}
subjectAltName = URI:mqttxt:fleet/acme, IP:127.0.0.1
"""


def self_signed(acme: Authority, name: str, usage: str) -> Path:
    """A node of the fleet whose certificate says all that it should, and is signed by its own key."""
    folder = acme.folder.parent / f"self-signed-{name}"
    shutil.copytree(acme.folder / name, folder)
    (folder / "openssl.cnf").write_text(_SELF_SIGNED.format(usage=usage))
    command = [
        "openssl",
        "req",
        "-x509",
        "-config",
        "openssl.cnf",
        "-newkey",
        "ed25519",
        "-nodes",
        "-subj",
        f"/CN={name}",
    ]
    files = ["-keyout", "identity.pem", "-out", "certificate.pem"]
    subprocess.run([*command, *files], cwd=folder, check=True, capture_output=True)
    return folder


def test_the_broker_refuses_a_nodes_certificate(acme: Authority, theirs: Authority, tmp_path: Path) -> None:
    stranger = theirs.folder / "drone1"
    for file in ("fleet.pem", "revoked.pem"):
        (stranger / file).write_bytes((acme.folder / file).read_bytes())
    broker = SecureBroker(acme, "broker-cloud")
    with ExitStack() as stack:
        stack.callback(broker.kill)
        broker.start()

        def said(folder: Path, system: Callable[[], float] | None = None) -> str | None:
            return asyncio.run(outcome(as_it_is(folder, system), broker.address))

        refused = "it refuses this node's certificate: "
        assert said(acme.folder / "drone1") is None
        assert said(acme.folder / "drone1", lambda: 0.0) is None  # a clock at 1970
        assert said(acme.folder / "drone2") == f"{refused}certificate expired"
        assert said(acme.folder / "drone3") == f"{refused}bad certificate"  # not yet valid, in TLS's words
        assert said(acme.folder / "drone4") == f"{refused}certificate revoked"
        assert (said(stranger) or "").startswith(refused)
        assert (said(self_signed(acme, "drone1", "clientAuth")) or "").startswith(refused)
        assert (said(acme.folder / "broker-cloud") or "").startswith(refused)  # a broker is no client


def wrong_broker(stack: ExitStack, acme: Authority, certified: Path, host: str = "127.0.0.1") -> BrokerAddress:
    """A broker of the fleet that shows the certificate of a folder."""
    broker = SecureBroker(acme, "broker-cloud", host=host)
    text = broker.configuration.read_text()
    for file in ("certificate.pem", "identity.pem"):
        text = text.replace(str(broker.files.identity.folder.resolve() / file), str(certified / file))
    broker.configuration.write_text(text)
    stack.callback(broker.kill)
    broker.start()
    return broker.address


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("broker-expired", "its certificate (broker-expired) is expired"),
        ("broker-early", "its certificate (broker-early) is not yet valid"),
        ("broker-revoked", "its certificate (broker-revoked) is revoked"),
        ("drone1", "certificate verify failed: unsuitable certificate purpose"),
        ("theirs", "certificate verify failed"),
        ("self-signed", "certificate verify failed: self-signed certificate"),
        ("elsewhere", "certificate verify failed: IP address mismatch"),
        ("broker-good", None),
    ],
)
def test_a_node_refuses_a_brokers_certificate(acme: Authority, theirs: Authority, name: str, why: str | None) -> None:
    folder = acme.folder / name
    with ExitStack() as stack:
        if name == "theirs":
            folder = theirs.folder / "broker-cloud"
        elif name == "self-signed":
            folder = self_signed(acme, "broker-cloud", "serverAuth")
        elif name == "elsewhere":
            folder = acme.folder / "broker-cloud"
        elif name.startswith("broker-"):
            shift = {"broker-expired": AGO, "broker-early": LATER}.get(name, timedelta(minutes=-5))
            acme.issue(name, days=1, not_before=datetime.now(UTC) + shift)
            stack.callback(lambda: [path.unlink() for path in (acme.folder / "issued").glob(f"{name}-*")])
            if name == "broker-revoked":
                acme.revoke(name)
        address = wrong_broker(stack, acme, folder, "127.0.0.2" if name == "elsewhere" else "127.0.0.1")
        said = asyncio.run(outcome(as_it_is(acme.folder / "drone1"), address))
    assert (said is None) == (why is None), said
    assert why is None or why in (said or "")
    assert "\n" not in (said or "")


def test_time_is_the_nodes_not_the_systems(acme: Authority) -> None:
    """A broker's certificate that is valid tomorrow, at a node that knows that it is tomorrow."""
    folder = acme.issue("broker-tomorrow", not_before=datetime.now(UTC) + LATER)
    tomorrow = (datetime.now(UTC) + LATER * 2).timestamp()
    with ExitStack() as stack:
        address = wrong_broker(stack, acme, folder)
        assert asyncio.run(outcome(as_it_is(acme.folder / "drone1", lambda: tomorrow), address)) is None
