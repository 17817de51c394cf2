"""Several fleets at one cluster of RabbitMQ nodes: each keeps to itself, and comes and goes while the others fly."""

from __future__ import annotations

import asyncio
import shutil
import socket
import ssl
from collections.abc import Iterator
from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path

import pytest

from mqttxt import FogUnreachable
from mqttxt.security.authority import Authority
from mqttxt.security.identity import Identity
from mqttxt.security.rights import Rights
from tests.rigs.cluster import NODES, Carried, Cluster, ClusteredSystem
from tests.rigs.processes import PATIENCE_S, eventually, wait_until
from tests.rigs.salvo import aloft
from tests.rigs.secure import Node

TESTED = ("deploy/cluster", "services/mqttxt/src/mqttxt/security/rabbitmq.py", "tests/rigs/cluster.py")
pytestmark = [pytest.mark.integration, pytest.mark.timeout(600), pytest.mark.soak(*TESTED)]
ARM, SENT = 400, 600
FLEETS = ("acme", "north")
NAMES = ("broker-fog1", "fog1", "drone1", "drone2")
TOPICS = {"fog1/reachable": ("fog1", "gs-ops"), "fog1/drone1/commands": ("gs-ops", "fog1")}
"""Who says what to whom, in each fleet."""
FAILS = """[exit(Listener, kill) || {{fleet, {<<"acme">>, _}, _}, Listener, _, _} <-
 supervisor:which_children(rabbit_mqtt_sup)]."""
"""Ends a node's listener of the fleet acme."""


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """Both fleets have the same prefix and the same names."""
    with closing(Cluster(tmp_path_factory.mktemp("cluster"))) as found:
        for name in FLEETS:
            found.add(name, NAMES)
        yield found.start()


def node(fleet: Carried, name: str, hears: str) -> Node:
    return Node(Identity.load(fleet.identity(name)), fleet, hears)


def answer(fleet: Carried, identity: Path, more: bytes = b"", flags: int = 2) -> bytes:
    """The first bytes that a fleet's port says to a CONNECT with an identity; raises OSError where it ends instead."""
    with connected(fleet, identity, more, flags) as sock:
        return sock.recv(4)


def connected(
    fleet: Carried, identity: Path, more: bytes = b"", flags: int = 2, client: bytes = b"same"
) -> ssl.SSLSocket:
    """A connection on which the CONNECT of a client id of four letters was sent, to a broker that is not checked."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    context.load_cert_chain(identity / "certificate.pem", identity / "identity.pem")
    address = fleet.address
    sock = context.wrap_socket(socket.create_connection((address.host, address.port), timeout=10))
    body = b"\0\4MQTT\5" + bytes([flags]) + b"\0\x3c\0\0\4" + client + more
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
    pem = (north.identity("broker-cloud") / "certificate.pem").read_text()
    new = ssl.PEM_cert_to_DER_cert(pem)
    wait_until(lambda: shown_by_all(north) == {new}, "the nodes have read the new certificate", 20)


def shown_by_all(fleet: Carried) -> set[bytes | None]:
    """The certificates of as many connections as reach every node."""
    with ExitStack() as open_ones:
        made = [open_ones.enter_context(connected(fleet, fleet.identity("gs-ops"))) for _ in range(2 * len(NODES))]
        return {each.getpeercert(binary_form=True) for each in made}


def test_an_authority_that_replaces_a_fleets_first_one_is_the_only_one_at_once(
    cluster: Cluster, tmp_path: Path
) -> None:
    """It comes between two looks of the nodes, as in a copy of the folder; somebody of the first is still connected."""
    old = cluster.add("east", NAMES)
    cluster.tell()
    wait_until(lambda: is_taken(old), "the nodes have opened the fleet's port")
    with ExitStack() as open_ones:
        clients = (b"old%d" % n for n in range(2 * len(NODES)))
        made = [open_ones.enter_context(connected(old, old.identity("gs-ops"), client=one)) for one in clients]
        assert {each.recv(256)[0] for each in made} == {0x20}
        new = replace(old, authority=Authority.create(tmp_path / "east", "east"))
        new.authority.issue("broker-cloud")
        new.authority.issue("gs-ops", Rights(None))
        for name in ("fleet.pem", "certificate.pem", "identity.pem"):
            shutil.copyfile(new.identity("broker-cloud") / name, cluster.folder_of("east") / name)
        wait_until(lambda: is_taken(new), "the new authority's are taken")
        assert {each.recv(256)[:1] for each in made} <= {b"", b"\xe0"}
    for _ in NODES:
        with pytest.raises(ssl.SSLError, match="UNKNOWN_CA"):
            answer(new, old.identity("gs-ops"))


def is_taken(fleet: Carried) -> bool:
    """Whether a fleet's station is let in, on as many connections at once as reach every node."""
    try:
        with ExitStack() as open_ones:
            clients = (b"new%d" % n for n in range(2 * len(NODES)))
            made = [open_ones.enter_context(connected(fleet, fleet.identity("gs-ops"), client=one)) for one in clients]
            return {(said[0], said[3]) for said in (each.recv(4) for each in made)} == {(0x20, 0)}
    except (OSError, IndexError):
        return False


def test_a_listener_that_fails_is_opened_again_and_ends_no_connection_of_another_fleet(cluster: Cluster) -> None:
    acme, north = (cluster.fleets[name] for name in FLEETS)
    with connected(acme, acme.identity("gs-ops")) as mine, connected(north, north.identity("gs-ops")) as theirs:
        assert (mine.recv(256)[0], theirs.recv(256)[0]) == (0x20, 0x20)
        for name in NODES:
            cluster.control(name, "eval", FAILS)
        assert mine.recv(256) == b""
        theirs.sendall(b"\xc0\0")
        assert theirs.recv(2) == b"\xd0\0"
    wait_until(lambda: is_taken(acme), "the nodes listen for the fleet again")


def test_files_that_the_nodes_may_not_read_yet_change_nothing(cluster: Cluster) -> None:
    """Who writes them as another user gives them to that of the nodes only afterwards."""
    acme = cluster.fleets["acme"]
    key = cluster.folder_of("acme") / "identity.pem"
    with connected(acme, acme.identity("gs-ops")) as mine:
        assert mine.recv(256)[0] == 0x20
        key.chmod(0)
        looked = cluster.add("west", NAMES)
        cluster.tell()
        wait_until(lambda: is_taken(looked), "the nodes have looked")
        mine.sendall(b"\xc0\0")
        assert mine.recv(2) == b"\xd0\0"
        key.chmod(0o600)


async def test_a_fleet_comes_and_goes_while_another_one_flies(cluster: Cluster, tmp_path: Path) -> None:
    acme = cluster.fleets["acme"]
    async with ClusteredSystem.running(tmp_path, acme) as flying, acme.station() as station:
        (fog,) = await station.connect([1], timeout_s=PATIENCE_S)
        salvo = await aloft(flying, fog)
        firing = asyncio.create_task(salvo.fire(fog, SENT))
        (tmp_path / "south").mkdir()
        south = cluster.add("south", NAMES)
        await asyncio.to_thread(cluster.tell)
        async with ClusteredSystem.running(tmp_path / "south", south) as system, south.station() as theirs:
            (their_fog,) = await theirs.connect([1], timeout_s=PATIENCE_S)
            await eventually(lambda: their_fog.drone(1).is_controlled, "the new fleet's drone is controlled")
            assert (await their_fog.drone(1).arm()).completed
            cluster.take_out("south")
            await eventually(lambda: not their_fog.is_live, "the nodes have closed the fleet's port")
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
