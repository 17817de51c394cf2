"""A cloud of three RabbitMQ nodes: a node is lost in one of three ways, or a link between two, while commands fly."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import closing
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from mqttxt import FogUnreachable, Stream
from tests.rigs.cluster import FORMING_S, NODES, Cluster, ClusteredSystem
from tests.rigs.processes import PATIENCE_S, eventually, wait_until
from tests.rigs.salvo import Salvo, aloft

TESTED = ("deploy/cluster", "services/mqttxt/src/mqttxt/security/rabbitmq.py", "tests/rigs/cluster.py")
pytestmark = [pytest.mark.integration, pytest.mark.timeout(900), pytest.mark.soak(*TESTED)]
BEFORE, DURING, LONG, TIMES = 20, 100, 300, 3
FAULTS: dict[str, tuple[Callable[[Cluster, str], None], Callable[[Cluster, str], None]]] = {
    "killed": (Cluster.kill, Cluster.start_again),
    "frozen": (Cluster.freeze, Cluster.thaw),
    "cut off from the others": (Cluster.cut_off, Cluster.join_again),
}


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    with closing(Cluster(tmp_path_factory.mktemp("cluster"))) as found:
        found.add()
        yield found.start()


@pytest.fixture
async def system(cluster: Cluster, tmp_path: Path) -> AsyncIterator[ClusteredSystem]:
    async with ClusteredSystem.running(tmp_path, cluster.fleets["acme"]) as found:
        yield found


@pytest.mark.parametrize("fault", FAULTS)
async def test_a_node_that_is_lost_makes_no_command_late_or_double_and_none_is_without_its_last_word(
    fault: str, cluster: Cluster, system: ClusteredSystem
) -> None:
    """Whoever a node that stood still has made deaf connects anew (R9.17), before the next node is lost."""
    begin, end = FAULTS[fault]
    async with cluster.fleets["acme"].station() as station:
        (fog,) = await station.connect([1], timeout_s=PATIENCE_S)
        salvo = await _flown_up(system, fog)
        for node in NODES:
            await _completed(fog)
            await salvo.fire(fog, BEFORE)
            firing = asyncio.create_task(salvo.fire(fog, DURING))
            await _under_way(salvo)
            await asyncio.to_thread(begin, cluster, node)
            lost_s = time.monotonic()
            completed_s = await _completed(fog)
            await firing
            print(f"{node} {fault}: a command sent {completed_s - lost_s:.1f} s later was completed")
            await asyncio.to_thread(end, cluster, node)
            await asyncio.to_thread(cluster.wait_formed)
        counts = salvo.verdict(fault)
        if counts["executed"] < len(NODES) * BEFORE:
            pytest.fail(f"{counts['executed']} commands were carried out, expected {len(NODES) * BEFORE} at least")
        assert counts["sent"] + counts["unsent"] == len(NODES) * (BEFORE + DURING)


async def test_two_nodes_that_reach_the_third_but_not_each_other_make_no_command_late_or_double(
    cluster: Cluster, system: ClusteredSystem
) -> None:
    """The station is connected to one end of the link that is cut, the activator to the other."""
    async with cluster.fleets["acme"].station() as station:
        (fog,) = await station.connect([1], timeout_s=PATIENCE_S)
        salvo = await _flown_up(system, fog)
        for _ in range(TIMES):
            await _completed(fog)
            ends = await asyncio.to_thread(_ends, cluster)
            await salvo.fire(fog, BEFORE)
            firing = asyncio.create_task(salvo.fire(fog, LONG))
            await _under_way(salvo)
            await asyncio.to_thread(cluster.cut_link, *ends)
            lost_s = time.monotonic()
            lasting, last = sorted(ends)
            await eventually(lambda: not fog.is_live, "the station sees that the fog is gone")
            gone_s = time.monotonic()
            await eventually(lambda: fog.is_live and fog.drone(1).is_reachable, "the station sees it again")
            back_s = time.monotonic()
            completed_s = await _completed(fog)
            await firing
            times = [f"{then_s - lost_s:.1f} s" for then_s in (gone_s, back_s, completed_s)]
            print(f"{ends} without a link: gone after {times[0]}, back after {times[1]}, completed after {times[2]}")
            assert not await asyncio.to_thread(cluster.serves, last)
            assert await asyncio.to_thread(cluster.serves, lasting)
            assert last not in await asyncio.to_thread(_places, cluster)
            await asyncio.to_thread(cluster.mend_link, *ends)
            await asyncio.to_thread(cluster.wait_formed)
            await asyncio.to_thread(wait_until, partial(cluster.serves, last), f"{last} takes clients again")
        counts = salvo.verdict("without a link")
        assert counts["executed"] >= TIMES * BEFORE
        assert counts["sent"] + counts["unsent"] == TIMES * (BEFORE + LONG)


def test_a_node_that_starts_without_a_link_to_another_one_is_given_no_clients(cluster: Cluster) -> None:
    """Nor for the time after which it is known that a third node sees both."""
    _, other, starting = NODES
    cluster.kill(starting)
    cluster.cut_link(other, starting)
    began = datetime.now(UTC)
    cluster.start_again(starting)
    wait_until(lambda: "takes no clients" in cluster.said(starting, began), "it has looked", FORMING_S)
    assert not cluster.serves(starting)
    assert f"Server nodes/{starting} is UP" not in cluster.said("balancer", began)
    cluster.mend_link(other, starting)
    cluster.wait_formed()
    wait_until(partial(cluster.serves, starting), f"{starting} takes clients again")


def _ends(cluster: Cluster) -> tuple[str, str]:
    """The nodes that the station and the activator are connected to; the station moves until these are two."""
    found: list[str | None] = []

    def are_two() -> bool:
        found[:] = _places(cluster)
        if found[0] == found[1]:
            cluster.control(NODES[0], "close_all_user_connections", "gs-ops", "moved")
        return None not in found and found[0] != found[1]

    wait_until(are_two, "station and activator are at two nodes")
    first, second = found
    assert first is not None
    assert second is not None
    return first, second


def _places(cluster: Cluster) -> list[str | None]:
    return [cluster.node_of(user) for user in ("gs-ops", "fog1")]


async def _flown_up(system: ClusteredSystem, fog: Any) -> Salvo:
    """Both drones, once no station of a test before has their control any more."""
    await eventually(lambda: all(fog.drone(number).is_controlled for number in (1, 2)), "both drones are controlled")
    return await aloft(system, fog)


async def _under_way(salvo: Salvo) -> None:
    sent = len(salvo.sent) + salvo.unsent
    await eventually(lambda: len(salvo.sent) + salvo.unsent > sent, "commands fly")


async def _completed(fog: Any) -> float:
    """When the first command was sent that was completed after this moment."""
    async with asyncio.timeout(PATIENCE_S):
        while True:
            sent_s = time.monotonic()
            try:
                if (await fog.drone(1).send(Stream("location", 5), ttl_s=1)).completed:
                    return sent_s
            except FogUnreachable:
                await asyncio.sleep(0.1)
