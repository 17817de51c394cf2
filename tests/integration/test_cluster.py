"""A cloud of three RabbitMQ nodes: one after the other is lost while commands fly, in three ways."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from mqttxt import FogUnreachable, Stream
from tests.rigs.cluster import NODES, Cluster, ClusteredSystem
from tests.rigs.processes import PATIENCE_S, eventually
from tests.rigs.salvo import Salvo, aloft

TESTED = ("deploy/cluster", "services/mqttxt/src/mqttxt/security/rabbitmq.py", "tests/rigs/cluster.py")
pytestmark = [pytest.mark.integration, pytest.mark.timeout(900), pytest.mark.soak(*TESTED)]
BEFORE, DURING = 20, 100
FAULTS: dict[str, tuple[Callable[[Cluster, str], None], Callable[[Cluster, str], None]]] = {
    "killed": (Cluster.kill, Cluster.start_again),
    "frozen": (Cluster.freeze, Cluster.thaw),
    "cut off from the others": (Cluster.cut_off, Cluster.join_again),
}


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    with closing(Cluster(tmp_path_factory.mktemp("cluster"))) as found:
        yield found.start()


@pytest.fixture
async def system(cluster: Cluster, tmp_path: Path) -> AsyncIterator[ClusteredSystem]:
    found = ClusteredSystem(tmp_path, cluster)
    try:
        yield await asyncio.to_thread(found.start)
    finally:
        await asyncio.to_thread(found.close)


@pytest.mark.parametrize("fault", FAULTS)
async def test_a_node_that_is_lost_makes_no_command_late_or_double_and_none_is_without_its_last_word(
    fault: str, cluster: Cluster, system: ClusteredSystem
) -> None:
    """Whoever a node that stood still has made deaf connects anew (R9.17), before the next node is lost."""
    begin, end = FAULTS[fault]
    async with cluster.station() as station:
        (fog,) = await station.connect([1], timeout_s=PATIENCE_S)
        salvo = await aloft(system, fog)
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
