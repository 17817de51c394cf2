"""compose.yaml by itself, without `make` and without a run's folder: the fleet on ideal links."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Iterator

import docker
import pytest

from testbed.fly.containers import PROJECT_LABEL, SERVICE_LABEL, compose_command, services_of
from testbed.fly.daemon import is_healthy
from testbed.plan.documents import ROOT

pytestmark = [
    pytest.mark.e2e,
    pytest.mark.timeout(600),
    pytest.mark.soak(
        "compose.yaml",
        *("services/Dockerfile", "services/entrypoint", "services/healthy", "services/join"),
        *("services/net/src", "services/net/unshaped.json"),
    ),
]
PROJECT = "mqttxt-plain"
HEALTHY_S = 180.0


def compose(profile: str, *words: str) -> None:
    environment = {name: value for name, value in os.environ.items() if name != "RUN_DIR"}
    command = [*compose_command(), "--project-name", PROJECT, "--profile", profile, *words]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.fixture(params=["mqttxt", "mavlink-sensors"])
def profile(request: pytest.FixtureRequest) -> Iterator[str]:
    name = str(request.param)
    try:
        compose(name, "up", "--detach", "--no-build")
        yield name
    finally:
        compose(name, "down", "--timeout", "3", "--volumes")


def test_compose_alone_brings_a_fleet_up_on_ideal_links(profile: str) -> None:
    client = docker.from_env()
    wanted, deadline_s = set(services_of((profile,))), time.monotonic() + HEALTHY_S
    while True:
        found = client.containers.list(all=True, filters={"label": f"{PROJECT_LABEL}={PROJECT}"})
        services = {container.labels[SERVICE_LABEL]: container for container in found}
        ended = {name: c.logs(tail=5).decode() for name, c in services.items() if c.status in ("exited", "dead")}
        assert not ended
        waiting = sorted(wanted - {name for name, container in services.items() if is_healthy(container)})
        if not waiting:
            break
        assert time.monotonic() < deadline_s, waiting
        time.sleep(0.5)
    assert "shapes nothing" in services["net"].exec_run(["cat", "/run-dir/links/shaper.json"]).output.decode()
    if profile == "mqttxt":
        armed = services["gs"].exec_run(["mqttxt", "gs", "send", "arm", "--fog", "1", "--drone", "2"])
        assert armed.exit_code == 0, armed.output.decode()
