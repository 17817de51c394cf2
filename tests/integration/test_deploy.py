"""deploy/: units that systemd takes and confines, manifests that Kubernetes' schemas take, a cloud that starts."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import docker
import kubernetes_validate
import pytest
import typer
import yaml
from cryptography import x509
from typer.testing import CliRunner

from mqttxt import FogUnreachable, GroundStation
from mqttxt.cli.main import app
from mqttxt.security.authority import Authority
from mqttxt.security.rights import Rights
from testbed.bootstrap.docker import compose_command
from tests.rigs.processes import ROOT, Process, free_port, wait_until
from tests.rigs.secure import SecureBroker
from tests.rigs.shaped_nodes import IMAGE

pytestmark = [pytest.mark.integration, pytest.mark.apart]
DEPLOY = ROOT / "deploy"
PROGRAM = "/opt/mqttxt/bin/mqttxt"
ROLES = ("drone", "fog")
MOST_EXPOSED = 20
"""Of 100, in systemd-analyze's own count."""
KUBERNETES = ("1.30", "1.37")


def unit(role: str) -> str:
    return (DEPLOY / "systemd" / f"mqttxt-{role}@.service").read_text()


@pytest.fixture(params=ROLES)
def installed(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A unit with a program that is there."""
    path = tmp_path / f"mqttxt-{request.param}@1.service"
    path.write_text(unit(request.param).replace(PROGRAM, "/usr/bin/env"))
    return path


def test_systemd_takes_each_unit_and_finds_it_confined(installed: Path) -> None:
    security = ["security", "--no-pager", "--offline=true", f"--threshold={MOST_EXPOSED}"]
    for words in (["verify", "--man=no"], security):
        done = subprocess.run(["systemd-analyze", *words, str(installed)], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        assert installed.name not in done.stderr, done.stderr


@pytest.mark.parametrize("role", ROLES)
def test_a_unit_starts_its_role_with_options_that_the_role_has(role: str) -> None:
    settings = (DEPLOY / "systemd" / f"{role}1.env").read_text()
    values = dict(line.split("=", 1) for line in settings.splitlines() if line and not line.startswith("#"))
    found = re.search(rf"^ExecStart={PROGRAM} (.+?[^\\])$", unit(role), re.MULTILINE | re.DOTALL)
    assert found is not None
    text = found[1].replace("\\\n", "").replace("%i", "1").replace("$OPTIONS", values["OPTIONS"])
    name, *words = [re.sub(r"\$\{(\w+)\}", lambda each: values[each[1]], word) for word in shlex.split(text)]
    group: Any = typer.main.get_command(app)
    context = group.commands[name].make_context(name, words)
    assert context.params["signed"]
    assert context.params["identity"] == Path(f"/var/lib/mqttxt/{role}1")


def manifests() -> list[dict[str, Any]]:
    built = subprocess.run(
        ["kubectl", "kustomize", str(DEPLOY / "kubernetes")], capture_output=True, text=True, check=True
    ).stdout
    return [each for each in yaml.safe_load_all(built) if each is not None]


@pytest.mark.parametrize("version", KUBERNETES)
def test_kubernetes_own_schemas_take_every_manifest(version: str) -> None:
    found = manifests()
    for manifest in found:
        kubernetes_validate.validate(manifest, version, strict=True)
    kinds = [manifest["kind"] for manifest in found]
    assert (kinds.count("StatefulSet"), kinds.count("PodDisruptionBudget")) == (3, 1)


def test_every_pod_is_confined_watched_and_has_its_identity() -> None:
    for manifest in manifests():
        if manifest["kind"] != "StatefulSet":
            continue
        pod = manifest["spec"]["template"]["spec"]
        assert pod["securityContext"]["runAsNonRoot"]
        for container in (*pod["initContainers"], *pod["containers"]):
            confined = container["securityContext"]
            assert confined["readOnlyRootFilesystem"]
            assert not confined["allowPrivilegeEscalation"]
            assert confined["capabilities"] == {"drop": ["ALL"]}
        assert all("livenessProbe" in container for container in pod["containers"])
        assert any("secret" in volume for volume in pod["volumes"])


def test_the_cluster_has_one_configuration_but_for_its_nodes_names() -> None:
    lines = [
        [line for line in (DEPLOY / folder / "rabbitmq.conf").read_text().splitlines() if "nodes" not in line]
        for folder in ("cluster", "kubernetes")
    ]
    assert lines[0] == lines[1]


def test_the_identities_are_issued_as_the_page_says_and_fit_the_names_in_the_settings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs" / "deploy.md").read_text()
    for line in re.findall(r"^mqttxt (keys .+)$", page, re.MULTILINE):
        done = CliRunner().invoke(app, shlex.split(line, comments=True))
        assert done.exit_code == 0, f"{line}: {done.output}"
    for role, broker in (("drone", "broker-fog1"), ("fog", "broker-cloud")):
        settings = (DEPLOY / "systemd" / f"{role}1.env").read_text()
        (host,) = set(re.findall(r"mqtts://([\w.]+)", settings))
        certificate = x509.load_pem_x509_certificate((tmp_path / "acme" / broker / "certificate.pem").read_bytes())
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        assert host in names.get_values_for_type(x509.DNSName)


class Cloud:
    """deploy/cloud as it stands, with the testbed's image."""

    def __init__(self, folder: Path) -> None:
        self.port = free_port()
        self.acme = Authority.create(folder / "acme", "acme")
        for name in ("broker-cloud", "broker-fog1", "fog1"):
            self.acme.issue(name)
        self.acme.issue("gs-ops", Rights(None))
        self.identity = self.acme.folder / "broker-cloud"
        self._give()
        self._project = f"mqttxt-cloud-{self.port}"
        self._environment = {
            **os.environ,
            **{"IMAGE": IMAGE, "IDENTITY": str(self.identity), "LISTEN": f"127.0.0.1:{self.port}"},
            "COMPOSE_PROJECT_NAME": self._project,
        }

    def _give(self) -> None:
        if os.geteuid() == 0:
            for path in (self.identity, *self.identity.iterdir()):
                os.chown(path, 1000, 1000)

    def take_members(self) -> None:
        """What was issued since is in the broker's folder; the broker is told."""
        self._give()
        subprocess.run([str(DEPLOY / "cloud" / "reload")], env=self._environment, check=True, capture_output=True)

    def compose(self, *words: str) -> None:
        command = [*(compose_command() or ()), "-f", str(DEPLOY / "cloud" / "compose.yaml"), *words]
        done = subprocess.run(command, env=self._environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr

    def is_healthy(self) -> bool:
        container = docker.from_env().containers.get(f"{self._project}_broker_1")
        return bool(container.attrs["State"]["Health"]["Status"] == "healthy")


@pytest.fixture
def cloud(tmp_path: Path) -> Iterator[Cloud]:
    found = Cloud(tmp_path)
    found.compose("config", "--quiet")
    try:
        found.compose("up", "--detach")
        yield found
    finally:
        found.compose("down", "--timeout", "3")


@pytest.mark.soak("deploy", "services/mqttxt/src/mqttxt/security", "services/mqttxt/src/mqttxt/cli/keys.py")
async def test_the_cloud_starts_with_its_identity_and_takes_who_was_issued_since(cloud: Cloud, tmp_path: Path) -> None:
    url = f"mqtts://localhost:{cloud.port}"
    fog = SecureBroker(cloud.acme, "broker-fog1").start()
    identity = ["--identity", str(cloud.acme.folder / "fog1"), "--ready-file", str(tmp_path / "fog1.ready")]
    brokers = ["--cloud", url, "--fog-broker", str(fog.address)]
    activator = Process(tmp_path, "fog1", "mqttxt", "activator", "--fog", "1", *brokers, *identity)
    try:
        wait_until(cloud.is_healthy, "the cloud's broker is healthy", 60)
        activator.start().wait_ready()
        cloud.acme.issue("gs-new", Rights(None))
        async with GroundStation(url, identity=cloud.acme.folder / "gs-new") as station:
            with pytest.raises(FogUnreachable):
                await station.connect([1], timeout_s=3)
        cloud.take_members()
        for name in ("gs-ops", "gs-new"):
            async with GroundStation(url, identity=cloud.acme.folder / name) as station:
                await station.connect([1])
        assert activator.stop() == 0
    finally:
        activator.kill()
        fog.kill()
