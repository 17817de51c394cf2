"""The nodes' network: everything goes by `net`, every frame is captured on both sides, nothing keeps its privileges."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import docker
import pytest
from scapy.utils import RawPcapReader

from testbed.fly.containers import PROJECT, PROJECT_LABEL, SERVICE_LABEL, Containers
from testbed.fly.links import write_plan
from testbed.plan.fleets import standard_fleet
from testbed.plan.profiles.reading import read_profile
from testbed.plan.profiles.resolve import resolve

pytestmark = [pytest.mark.integration, pytest.mark.alone, pytest.mark.timeout(180)]
OFFLOADS = ("tcp-segmentation-offload", "generic-segmentation-offload", "generic-receive-offload", "tx-checksumming")
PINGS = 5
PING_SIZE = 777
ECHOES = {"gs": PINGS, "cloud": 2 * PINGS, "fog1": 2 * PINGS, "uav1": PINGS}
"""A node between sees each twice: as it comes, and as it goes on."""
NANOSECONDS_MAGIC = (0xA1B23C4D).to_bytes(4, "little")


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    for path in (folder, folder / "pcap", folder / "sitl", folder / "links"):
        path.mkdir(exist_ok=True)
        path.chmod(0o777)
    topology = standard_fleet().topology()
    links = resolve(read_profile("ideal"), topology, "scenario-1", 1)
    write_plan(folder / "links", links, topology, "auto")
    return folder


@pytest.fixture(scope="module")
def fleet(run_dir: Path) -> Iterator[Containers]:
    made = Containers("mqttxt", run_dir, {"QOS": "0"}, standard_fleet())
    try:
        made.down()
        made.start()
        yield made
    finally:
        made.down()


def container(service: str) -> Any:
    labels = [f"{PROJECT_LABEL}={PROJECT}", f"{SERVICE_LABEL}={service}"]
    (found,) = docker.from_env().containers.list(filters={"label": labels})
    return found


def test_every_node_reaches_every_other_by_net_and_the_nodes_between(fleet: Containers) -> None:
    nodes = standard_fleet().topology().nodes
    for node in nodes:
        gateway = node.address.rsplit(".", 1)[0] + ".2"
        others = [other.address for other in nodes if other != node]
        shown = fleet.output(node.name, ["sh", "-c", 'for to; do ip route get "$to"; done', "sh", *others])
        assert [line.split()[:3] for line in shown.splitlines() if line[0].isdigit()] == [
            [other, "via", gateway] for other in others
        ]
    reached = fleet.output("gs", ["ping", "-c", "1", "-W", "2", "198.18.26.3"])
    assert " 0% packet loss" in reached
    assert "ttl=59 " in reached  # of 64: fog2, cloud, and net three times


def test_offloads_are_off_on_both_ends_of_every_cable(fleet: Containers) -> None:
    nodes = standard_fleet().topology().nodes
    gateways = {node.address.rsplit(".", 1)[0] + ".2" for node in nodes}
    shown = json.loads(fleet.output("net", ["ip", "-json", "-4", "addr"]))
    ports = [link["ifname"] for link in shown if gateways & {info["local"] for info in link["addr_info"]}]
    assert len(ports) == len(nodes)  # those towards sensors that are not there have no node
    ends = [(node.name, "eth0") for node in nodes] + [("net", port) for port in ports]
    for service, interface in ends:
        shown = fleet.output(service, ["ethtool", "-k", interface])
        states = dict(line.split(": ", 1) for line in shown.splitlines() if ": " in line and line[0] != "\t")
        assert {name: states[name].split()[0] for name in OFFLOADS} == dict.fromkeys(OFFLOADS, "off"), service


@pytest.mark.parametrize("service", ["gs", "uav1", "broker", "activator1", "client1", "sitl1"])
def test_a_command_has_no_root_no_capability_and_no_way_back(fleet: Containers, service: str) -> None:
    # The container's init process starts the command and stays as it was; the command is its child.
    processes = container(service).top(ps_args="-eo pid,uid,args")["Processes"]
    assert {uid for _, uid, command in processes if "docker-init" not in command} == {"1000"}, processes
    status = fleet.output(service, ["sh", "-c", "cat /proc/$(cat /proc/1/task/1/children | cut -d' ' -f1)/status"])
    fields = dict(line.split(":\t", 1) for line in status.splitlines() if ":\t" in line)
    assert {fields[name] for name in ("CapEff", "CapPrm", "CapBnd", "CapAmb")} == {"0" * 16}
    assert fields["NoNewPrivs"] == "1"
    assert container(service).attrs["HostConfig"]["ReadonlyRootfs"]


def echoes(path: Path) -> int:
    """ICMP echo requests of this test's size in a capture."""
    with RawPcapReader(str(path)) as frames:
        sizes = [data[34] == 8 for data, _ in frames if len(data) == PING_SIZE + 42 and data[23] == 1]
    return sum(sizes)


def test_a_frame_is_in_the_captures_of_every_node_on_its_way_and_none_is_lost_at_the_end(
    fleet: Containers, run_dir: Path
) -> None:
    ping = ["ping", "-c", str(PINGS), "-i", "0.2", "-s", str(PING_SIZE), "198.18.21.3"]
    assert f"{PINGS} received" in fleet.output("gs", ping)
    fleet.stop("net")
    counts = {count["node"]: count for count in json.loads((run_dir / "pcap" / "captures.json").read_text())}
    assert set(counts) == {node.name for node in standard_fleet().topology().nodes}
    for node, count in counts.items():
        path = run_dir / "pcap" / f"{node}.pcap"
        assert path.read_bytes()[:4] == NANOSECONDS_MAGIC
        assert count["dropped"] == 0
        with RawPcapReader(str(path)) as frames:
            assert sum(1 for _ in frames) == count["captured"] > 0
        assert echoes(path) == ECHOES.get(node, 0), node
