"""What compose makes of compose.yaml with another autopilot or router laid over it; nothing is started."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml

from testbed.fly.containers import compose_command
from testbed.plan.fleets import standard_fleet
from testbed.plan.overrides import compose_files
from tests.rigs.processes import ROOT

pytestmark = pytest.mark.integration
DRONES = [drone for drones in standard_fleet().fogs.values() for drone in drones]


def resolved(profile: str, settings: dict[str, str], **environment: str) -> dict[str, Any]:
    """The services of a profile as compose would start them."""
    files = [word for path in compose_files(settings, standard_fleet(), ROOT) for word in ("--file", str(path))]
    command = [*compose_command(), *files, "--profile", profile, "config"]
    done = subprocess.run(
        command, cwd=ROOT, env={**os.environ, **environment}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = yaml.safe_load(done.stdout)["services"]
    for service in found.values():
        for name in ("cap_add", "profiles", "volumes"):  # compose puts them in another order where it joins two files
            service[name] = sorted(service.get(name, []), key=str)
    return {name: service for name, service in found.items() if profile in service["profiles"]}


def said(service: dict[str, Any], what: str = "command") -> str:
    value = service[what]
    return value if isinstance(value, str) else " ".join(value)


@pytest.mark.parametrize("kind", ["px4", "ardupilot"])
@pytest.mark.parametrize("profile", ["mqttxt", "mavlink", "mqttxt-one", "mavlink-one"])
def test_a_real_autopilot_takes_the_place_of_each_stand_in(profile: str, kind: str) -> None:
    plain, services = resolved(profile, {}), resolved(profile, {"AUTOPILOT": kind}, AUTOPILOT_DIR="/srv/real")
    assert services.keys() == plain.keys()
    changed = {name for name in services if services[name] != plain[name]}
    assert changed == ({"sitl1"} if profile.endswith("-one") else {f"sitl{drone}" for drone in DRONES})
    for name in changed:
        sitl = services[name]
        same = ("command", "entrypoint", "network_mode", "read_only", "healthcheck", "image", "cap_drop", "cap_add")
        assert {key: sitl[key] for key in same} == {key: plain[name][key] for key in same}
        assert sitl["environment"] == {"SITL_AUTOPILOT": kind}
        assert any("/srv/real" in str(volume) and "/opt/autopilot" in str(volume) for volume in sitl["volumes"])


def test_the_way_of_a_direct_chain_reaches_whatever_flies() -> None:
    there = {"AUTOPILOT_DIR": "/srv/px4", "AUTOPILOT_TO": "198.18.0.3"}
    services = resolved("mavlink", {"AUTOPILOT": "px4"}, **there)
    assert "--send 198.18.0.3:14544" in said(services["sitl4"])


def test_the_official_mavp2p_changes_the_routers_image_and_nothing_else() -> None:
    plain, services = resolved("mavlink", {}), resolved("mavlink", {"ROUTER": "official"})
    changed = {name for name in services if services[name] != plain.get(name)}
    assert changed == {name for name in plain if name.startswith("router-")}
    for name in changed:
        assert services[name] == {**plain[name], "image": "mqttxt-testbed/node:official"}


def test_the_official_image_s_dockerfile_puts_it_where_the_routers_run_it() -> None:
    text = Path(ROOT / "services" / "router" / "overrides" / "official.Dockerfile").read_text()
    assert "COPY --from=official /mavp2p /usr/local/bin/mavp2p" in text
