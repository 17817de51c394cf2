"""The containers' own roles keep every rule of the specification, on the testbed's links beside the fleet."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from testbed.plan.documents import ROOT
from tests.e2e.flying import containers

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(800), pytest.mark.soak("services/mqttxt/src", "compose.yaml")]

CLOUD = "mqtt://198.18.1.3:1883"
CHECKS = {
    "gs": (
        *("gs", "--broker", CLOUD, "--fog", "8", "--drone", "1"),
        *("--run", "mqttxt gs send hold --cloud {broker} --fog {fog} --drone {drone} --insecure"),
    ),
    "fog1": (
        *("activator", "--broker", CLOUD, "--fog-broker", "mqtt://127.0.0.1:1883"),
        *("--fog", "9", "--fog-root", "fog9/local/"),
        "--run",
        "mqttxt activator --fog {fog} --cloud {broker} --fog-broker {fog_broker} --fog-root {fog_root} "
        "--drones {drones} --insecure --audit {audit}",
    ),
    "uav1": (
        *("uav", "--broker", CLOUD, "--drone", "77", "--autopilot", "udp:127.0.0.1:15540"),
        "--run",
        "mqttxt uav --drone {drone} --broker {broker} --autopilot {autopilot} --insecure "
        "--journal /tmp/drone77.journal --audit {audit}",
    ),
}
"""In which container, and what: fogs and a drone that the fleet does not have."""


def carry_out(*command: str) -> None:
    subprocess.run([sys.executable, "-m", "testbed", *command], cwd=ROOT, check=True, capture_output=True, timeout=200)


@pytest.fixture
def fleet() -> Iterator[dict[str, Any]]:
    carry_out("up", "--security", "none")
    try:
        yield containers()
    finally:
        carry_out("down")


def test_every_role_of_the_containers_keeps_every_rule(fleet: dict[str, Any]) -> None:
    def check(service: str) -> tuple[int, bytes]:
        command = ["mqttxt", "conformance", *CHECKS[service], "--format", "json"]
        code, output = fleet[service].exec_run(command, user="1000:1000", stderr=False)
        return code, output

    with ThreadPoolExecutor(len(CHECKS)) as pool:
        results = dict(zip(CHECKS, pool.map(check, CHECKS), strict=True))
    for service, (code, output) in results.items():
        findings = json.loads(output)["findings"]
        failed = [finding for finding in findings if finding["verdict"] == "fail"]
        assert (code, failed) == (0, []), service
        untested = [finding for finding in findings if finding["verdict"] == "not tested"]
        # One command to one drone has no seq to rise, and is no broadcast.
        assert len(untested) <= (2 if service == "gs" else 0), untested
