"""A campaign on several machines: real workers and a scheduler over TLS, of which some are killed in mid-flight."""

from __future__ import annotations

import asyncio
import os
import signal
import ssl
from collections.abc import Iterator
from pathlib import Path

import pytest
from distributed.comm.core import connect

from testbed.errors import TestbedError, UserError
from testbed.fly.campaign.certificate import check_scheduler, make_certificate, security_of
from testbed.fly.campaign.machines import schedule
from testbed.fly.campaign.pushing import INCOMING
from testbed.fly.campaign.run import job_of
from testbed.fly.campaign.targets import Wish, plans_of
from testbed.fly.campaign.worker import work
from testbed.fly.results import Series
from tests.rigs.campaigns import ATTEMPT_BYTES, Campaign, Machines
from tests.rigs.processes import eventually, free_port, wait_until

pytestmark = [pytest.mark.integration, pytest.mark.apart, pytest.mark.timeout(400)]
FOUR = Wish(experiments="scenario-1,scenario-3", arms="thesis,direct", profiles="ideal")


@pytest.fixture
def machines(tmp_path: Path) -> Iterator[Machines]:
    made = Machines(tmp_path)
    try:
        made.start_scheduler()
        yield made
    finally:
        made.close()


def flown_on(series: Series) -> set[str]:
    return {attempt.manifest()["host"]["name"] for attempt in series.attempts()}


def children_of(pid: int) -> list[int]:
    """Of every thread."""
    return [
        int(child) for task in Path(f"/proc/{pid}/task").iterdir() for child in (task / "children").read_text().split()
    ]


@pytest.mark.soak("testbed/fly/campaign", "tests/rigs/campaigns.py")
def test_a_worker_that_is_killed_in_flight_loses_nothing_and_nothing_counts_twice(
    tmp_path: Path, machines: Machines
) -> None:
    for name in ("first", "second"):
        machines.start_worker(name)
    plans, root = plans_of(FOUR), tmp_path / "results"
    campaign = Campaign(plans, root, machines)
    wait_until(lambda: list(machines.kept_by("first").glob("*/*/*/mavlink/attempt-01")), "the first flies its second")
    flying = children_of(machines.processes["first"].pid)
    (cut,) = {path.parts[-5:-2] for path in machines.kept_by("first").glob("*/*/*/mavlink/attempt-01")}
    machines.kill("first")
    campaign.wait()
    assert campaign.raised is None
    assert campaign.counted, campaign.said()
    found = [Series(path) for path in root.glob("scenario-*/*-ideal/*")]
    assert len(found) == len(plans) == 4
    assert all(job_of(plan, root).done for plan in plans)
    for series in found:
        assert [(attempt.protocol, attempt.number, attempt.repeat) for attempt in series.attempts()] == [
            ("mavlink", 1, 0),
            ("mqttxt", 1, 0),
        ]
        assert len(flown_on(series)) == 1
        assert [path.stat().st_size for path in series.path.glob("*/*/logs/big.log")] == [ATTEMPT_BYTES] * 2
    (again,) = (root / cut[0] / cut[1]).glob("2*")
    assert flown_on(Series(again)) == {"second"}
    assert not list((root / INCOMING).glob("*"))
    assert not list(machines.kept_by("second").glob("*/*/*/*"))
    wait_until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in flying), "the killed worker's flight has ended")
    assert "first: gone; what it did not push is flown elsewhere" in campaign.said()
    assert "4 of 4 done" in campaign.said()
    again_flown = Campaign(plans, root, machines)
    again_flown.wait()
    assert again_flown.said().strip().endswith("4 done")


async def test_who_has_another_campaigns_certificate_or_none_gets_nowhere(tmp_path: Path) -> None:
    for name in ("campaign.pem", "other.pem"):
        make_certificate(tmp_path / name)
    security, other = security_of(tmp_path / "campaign.pem"), security_of(tmp_path / "other.pem")
    address, said = f"tls://127.0.0.1:{free_port()}", list[str]()
    scheduler = asyncio.create_task(schedule(int(address.rpartition(":")[2]), security, said.append))
    await eventually(lambda: said, "the scheduler is there")
    await asyncio.to_thread(check_scheduler, address, security)
    with pytest.raises(UserError, match="it has another certificate"):
        await asyncio.to_thread(check_scheduler, address, other)
    with pytest.raises(OSError, match="CERTIFICATE_REQUIRED"):
        await connect(address, ssl_context=without_a_certificate())
    with pytest.raises(OSError, match="closed"):
        await connect(address.replace("tls", "tcp"))
    scheduler.cancel()
    await asyncio.gather(scheduler, return_exceptions=True)


def without_a_certificate() -> ssl.SSLContext:
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    return context


async def test_a_worker_ends_with_its_scheduler_or_when_asked_to_and_has_a_name_of_its_own(tmp_path: Path) -> None:
    make_certificate(tmp_path / "campaign.pem")
    security, port = security_of(tmp_path / "campaign.pem"), free_port()
    said: list[str] = []

    def start(name: str) -> asyncio.Task[None]:
        return asyncio.create_task(work(f"tls://127.0.0.1:{port}", security, name, tmp_path / name, said.append))

    scheduler = asyncio.create_task(schedule(port, security, said.append))
    await eventually(lambda: said, "the scheduler is there")
    first = start("first")
    await eventually(lambda: len(said) == 2, "the first worker is there")
    with pytest.raises(UserError, match="MACHINE=first: another worker has this name"):
        await start("first")
    os.kill(os.getpid(), signal.SIGTERM)
    assert await first is None
    second = start("second")
    await eventually(lambda: len(said) == 3, "the second worker is there")
    scheduler.cancel()
    with pytest.raises(TestbedError, match="the scheduler has ended, or has given second up"):
        await second
