"""Several fleets at one cluster of RabbitMQ nodes: each keeps to itself, and comes and goes while the others fly."""

from __future__ import annotations

import asyncio
import socket
import ssl
from collections.abc import AsyncIterator, Iterator
from contextlib import closing
from pathlib import Path

import pytest

from mqttxt import FogUnreachable
from mqttxt.security.authority import Authority
from mqttxt.security.identity import Identity
from mqttxt.security.rights import Rights
from tests.rigs.cluster import NODES, Carried, Cluster, ClusteredSystem
from tests.rigs.processes import PATIENCE_S, eventually
from tests.rigs.salvo import aloft
from tests.rigs.secure import Node

TESTED = ("deploy/cluster", "services/mqttxt/src/mqttxt/security/rabbitmq.py", "tests/rigs/cluster.py")
pytestmark = [pytest.mark.integration, pytest.mark.timeout(600), pytest.mark.soak(*TESTED)]
ARM, SENT = 400, 600
FLEETS = ("acme", "north")
NAMES = ("broker-fog1", "fog1", "drone1", "drone2")
TOPICS = {"fog1/reachable": ("fog1", "gs-ops"), "fog1/drone1/commands": ("gs-ops", "fog1")}
"""Who says what to whom, in each fleet."""


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """Both fleets have the same prefix and the same names."""
    with closing(Cluster(tmp_path_factory.mktemp("cluster"))) as found:
        for name in FLEETS:
            found.add(name, NAMES)
        yield found.start()


@pytest.fixture
async def flying(cluster: Cluster, tmp_path: Path) -> AsyncIterator[ClusteredSystem]:
    found = ClusteredSystem(tmp_path, cluster.fleets["acme"])
    try:
        yield await asyncio.to_thread(found.start)
    finally:
        await asyncio.to_thread(found.close)


def node(fleet: Carried, name: str, hears: str) -> Node:
    return Node(Identity.load(fleet.identity(name)), fleet, hears)


def answer(fleet: Carried, identity: Path, more: bytes = b"", flags: int = 2) -> bytes:
    """The first bytes that a fleet's port says to a CONNECT with an identity; raises OSError where it ends instead."""
    with connected(fleet, identity, more, flags) as sock:
        return sock.recv(4)


def connected(fleet: Carried, identity: Path, more: bytes = b"", flags: int = 2) -> ssl.SSLSocket:
    """A connection on which the CONNECT of the client id "same" was sent, to a broker that is not checked."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    context.load_cert_chain(identity / "certificate.pem", identity / "identity.pem")
    address = fleet.address
    sock = context.wrap_socket(socket.create_connection((address.host, address.port), timeout=10))
    body = b"\0\4MQTT\5" + bytes([flags]) + b"\0\x3c\0\0\4same" + more
    sock.sendall(bytes([0x10, len(body)]) + body)
    return sock


@pytest.mark.parametrize("topic", TOPICS)
def test_fleets_with_the_same_topics_and_names_hear_nothing_of_each_other(cluster: Cluster, topic: str) -> None:
    sender, receiver = TOPICS[topic]
    for fleet, other in (FLEETS, FLEETS[::-1]):
        heard, deaf = (node(cluster.fleets[name], receiver, topic) for name in (fleet, other))
        says = node(cluster.fleets[fleet], sender, "fleet/revoked")
        with closing(heard), closing(deaf), closing(says):
            says.publish([topic], b"said")
            for each in (heard, deaf):
                each.subscribe(topic)
            assert (heard.heard, deaf.heard) == ({(topic, b"said")}, set())


def test_an_authority_makes_no_node_of_another_fleet(cluster: Cluster, tmp_path: Path) -> None:
    """Nor does one that calls itself by the other's name."""
    acme, north = (cluster.fleets[name] for name in FLEETS)
    false = Authority.create(tmp_path / "false", "north")
    identities = [acme.identity("gs-ops"), acme.identity("fog1")]
    identities += [false.issue("gs-ops", Rights(None)), false.issue("fog1")]
    for identity in identities:
        with pytest.raises(ssl.SSLError, match="UNKNOWN_CA"):
            answer(north, identity)
    assert answer(north, north.identity("gs-ops"))[0] == 0x20


def test_no_user_name_leads_to_another_fleet_and_a_client_id_is_one_of_its_fleet(cluster: Cluster) -> None:
    acme, north = (cluster.fleets[name] for name in FLEETS)
    named = b"\0\x0cnorth:gs-ops"
    for more, flags in ((named, 0x82), (named + b"\0\1x", 0xC2)):
        said = answer(acme, acme.identity("gs-ops"), more, flags)
        assert said == b"" or (said[0], said[3]) in {(0x20, 0x86), (0x20, 0x87)}, said
    with connected(acme, acme.identity("gs-ops")) as mine:
        assert (first := mine.recv(256))[0] == 0x20, first
        assert answer(north, north.identity("gs-ops"))[0] == 0x20
        mine.sendall(b"\xc0\0")
        assert mine.recv(2) == b"\xd0\0"


def test_who_is_revoked_in_one_fleet_stays_in_the_other(cluster: Cluster) -> None:
    acme, north = (cluster.fleets[name] for name in FLEETS)
    north.authority.issue("gs-gone", Rights(None))
    acme.authority.issue("gs-gone", Rights(None))
    for name in FLEETS:
        cluster.write(name)
    cluster.tell()
    with connected(acme, acme.identity("gs-gone")) as mine, connected(north, north.identity("gs-gone")) as theirs:
        assert (mine.recv(256)[0], theirs.recv(256)[0]) == (0x20, 0x20)
        north.authority.revoke("gs-gone")
        cluster.write("north")
        cluster.control(NODES[1], "eval", 'fleets:revoke(<<"north">>, <<"gs-gone">>).')
        assert theirs.recv(256)[:1] in (b"", b"\xe0")
        mine.sendall(b"\xc0\0")
        assert mine.recv(2) == b"\xd0\0"
    assert answer(north, north.identity("gs-gone"))[3:] != b"\0"
    assert answer(acme, acme.identity("gs-gone"))[3:] == b"\0"


def test_who_connects_after_a_renewal_is_shown_the_new_certificate(cluster: Cluster) -> None:
    north = cluster.fleets["north"]
    north.authority.renew("broker-cloud")
    cluster.write("north")
    for name in NODES:
        cluster.control(name, "eval", "ssl:clear_pem_cache().")
    with connected(north, north.identity("gs-ops")) as sock:
        shown = sock.getpeercert(binary_form=True)
    pem = (north.identity("broker-cloud") / "certificate.pem").read_text()
    assert shown == ssl.PEM_cert_to_DER_cert(pem)


async def test_a_fleet_comes_and_goes_while_another_one_flies(
    cluster: Cluster, flying: ClusteredSystem, tmp_path: Path
) -> None:
    async with cluster.fleets["acme"].station() as station:
        (fog,) = await station.connect([1], timeout_s=PATIENCE_S)
        salvo = await aloft(flying, fog)
        firing = asyncio.create_task(salvo.fire(fog, SENT))
        (tmp_path / "south").mkdir()
        south = cluster.add("south", NAMES)
        await asyncio.to_thread(cluster.tell)
        system = ClusteredSystem(tmp_path / "south", south)
        try:
            await asyncio.to_thread(system.start)
            async with south.station() as theirs:
                (their_fog,) = await theirs.connect([1], timeout_s=PATIENCE_S)
                await eventually(lambda: their_fog.drone(1).is_controlled, "the new fleet's drone is controlled")
                assert (await their_fog.drone(1).arm()).completed
                cluster.take_out("south")
                await eventually(lambda: not their_fog.is_live, "the nodes have closed the fleet's port")
        finally:
            await asyncio.to_thread(system.close)
        await firing
        counts = salvo.verdict("a fleet comes and goes")
        assert (counts["sent"], counts["unsent"]) == (SENT, 0)
        assert {word for word, count in counts.items() if count} & {"unreachable", "unconfirmed"} == set()
        assert fog.drone(1).is_controlled
    assert [len(each.commanded(1, ARM)) for each in (flying, system)] == [1, 1]
    assert "trying again" not in flying.activator.said()
    async with south.station() as theirs:
        with pytest.raises(FogUnreachable):
            await theirs.connect([1], timeout_s=3)
