"""The preparation's decisions: what is made again, what is said when something is missing."""

from __future__ import annotations

import re
import subprocess
import sys
from collections import namedtuple
from collections.abc import Callable
from pathlib import Path

import pytest

from testbed.bootstrap import docker as bootstrap_docker
from testbed.bootstrap import steps, venv
from testbed.bootstrap.images import node_inputs
from testbed.bootstrap.steps import BootstrapError, check_disk, check_python, known_cause, run, succeeds

Usage = namedtuple("Usage", "total used free")


@pytest.fixture
def sources(tmp_path: Path) -> Path:
    (tmp_path / "requirements").mkdir()
    (tmp_path / "requirements" / "node.txt").write_text("cbor2==6\n")
    (tmp_path / "services" / "net").mkdir(parents=True)
    (tmp_path / "services" / "net" / "a.py").write_text("1\n")
    return tmp_path


@pytest.mark.parametrize(
    "change",
    [
        lambda root: (root / "services" / "net" / "a.py").write_text("2\n"),
        lambda root: (root / "services" / "net" / "b.py").write_text("1\n"),
        lambda root: (root / "services" / "net" / "a.py").chmod(0o755),
        lambda root: (root / "requirements" / "node.txt").write_text("cbor2==7\n"),
    ],
)
def test_the_image_is_made_again_when_its_inputs_change(sources: Path, change: Callable[[Path], object]) -> None:
    before = node_inputs(sources)
    change(sources)
    assert node_inputs(sources) != before


@pytest.mark.parametrize("name", [".ruff_cache/x", "net/__pycache__/a.pyc", "mqttxt.egg-info/PKG-INFO"])
def test_the_image_is_kept_when_a_tool_leaves_files(sources: Path, name: str) -> None:
    before = node_inputs(sources)
    path = sources / "services" / name
    path.parent.mkdir(parents=True)
    path.write_text("left over")
    assert node_inputs(sources) == before


@pytest.mark.parametrize(
    ("output", "said"),
    [
        ("write /x: no space left on device", "the disk is full"),
        ("Temporary failure resolving 'a'", "no network"),
        ("NewConnectionError: Failed to establish a new connection: [Errno 101]", "no network"),
        ("permission denied while trying to connect to the Docker daemon socket", "no rights for the Docker daemon"),
        ("SSLError: certificate verify failed", "a proxy's certificate is not trusted"),
        ("ERROR: Could not find a version of x (from versions: none)", "no network"),
        ("SyntaxError", None),
    ],
)
def test_common_causes_are_said_in_one_line(output: str, said: str | None) -> None:
    cause = known_cause(output)
    assert cause is None if said is None else cause is not None and cause.startswith(said) and "\n" not in cause


def test_a_program_that_fails_shows_its_last_lines() -> None:
    script = "import sys; print('first'); print('last'); sys.exit(3)"
    with pytest.raises(BootstrapError, match=r"failed with exit code 3:\n    first\n    last"):
        run([sys.executable, "-c", script])


def test_a_program_that_is_missing_or_hangs_is_named() -> None:
    with pytest.raises(BootstrapError, match="no-such-program is not installed"):
        run(["no-such-program"])
    with pytest.raises(BootstrapError, match="did not end within 0 s"):
        run([sys.executable, "-c", "import signal; signal.pause()"], timeout_s=0.2)
    assert not succeeds(["no-such-program"])


def test_an_old_python_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(steps.sys, "version_info", (3, 10, 2))
    with pytest.raises(BootstrapError, match=re.escape("python3 is 3.10.2; expected 3.11 or newer")):
        check_python()


def test_a_full_disk_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(steps.shutil, "disk_usage", lambda _: Usage(0, 0, 5 * 2**20))
    with pytest.raises(BootstrapError, match="disk of /data: 5 MiB free, expected at least 10 MiB"):
        check_disk(Path("/data"), 10)


def test_without_root_the_command_to_type_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(steps.os, "geteuid", lambda: 1000)
    monkeypatch.setattr(steps.shutil, "which", lambda _: "/usr/bin/apt-get")
    with pytest.raises(BootstrapError, match=r"sudo apt-get install --yes .* docker\.io"):
        steps.apt_install(["docker.io"], "no Docker daemon is installed")


def test_a_daemon_elsewhere_is_not_started_here(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DOCKER_HOST", "tcp://198.51.100.1:2375")
    monkeypatch.setattr(bootstrap_docker, "daemon_answers", lambda: False)
    monkeypatch.setattr(bootstrap_docker.shutil, "which", lambda _: "/usr/bin/docker")
    with pytest.raises(BootstrapError, match=r"DOCKER_HOST=tcp:.*: no Docker daemon answers there"):
        bootstrap_docker.ensure_docker()


def test_an_environment_stays_when_a_new_one_cannot_be_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> None:
        venv.VENV.mkdir()
        raise BootstrapError("no network")

    cache = tmp_path / ".cache"
    for name, value in {"CACHE": cache, "VENV": tmp_path / ".venv", "_OLD": cache / "old", "_make": fail}.items():
        monkeypatch.setattr(venv, name, value)
    monkeypatch.setattr(venv, "venv_is_current", lambda: False)
    monkeypatch.setattr(venv, "check_disk", lambda *_: None)
    (tmp_path / ".venv").mkdir()
    (tmp_path / ".venv" / "kept").touch()
    with pytest.raises(BootstrapError, match="no network"):
        venv.ensure_venv()
    assert (tmp_path / ".venv" / "kept").exists()


@pytest.mark.long
@pytest.mark.parametrize(("name", "said"), [("mqttxt", "keys"), ("testbed", "verdict")])
def test_the_environment_has_the_commands_that_the_pages_type(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, said: str
) -> None:
    made = tmp_path / "an environment"
    (made / "bin").mkdir(parents=True)
    (made / "bin" / "python").write_text(f"#!/bin/sh\nexec '{sys.executable}' \"$@\"\n")
    (made / "bin" / "python").chmod(0o755)
    monkeypatch.setattr(venv, "VENV", made)
    monkeypatch.setattr(venv, "CACHE", tmp_path)
    monkeypatch.setattr(venv, "venv_is_current", lambda: True)
    for _ in range(2):
        venv.ensure_venv()
    shown = subprocess.run([made / "bin" / name, "--help"], capture_output=True, text=True, check=True, cwd="/")
    assert f"Usage: {name} " in shown.stdout
    assert said in shown.stdout


@pytest.mark.parametrize(("pin", "upgrades"), [(venv.lock, False), (venv.upgrade, True)])
def test_pins_stay_unless_an_upgrade_is_asked_for(
    pin: Callable[[], None], upgrades: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    typed: list[list[str]] = []
    monkeypatch.setattr(venv, "run", typed.append)
    pin()
    compiled = [words for words in typed if "compile" in words]
    assert len(compiled) == len(list((steps.ROOT / "requirements").glob("*.in")))
    assert all(("--upgrade" in words) == upgrades for words in compiled)


def test_dockers_containers_get_real_time_where_the_kernel_gives_it_by_cgroup(tmp_path: Path) -> None:
    of_all = tmp_path / "cpu.rt_runtime_us"
    bootstrap_docker.give_real_time(of_all)
    assert not list(tmp_path.iterdir())
    of_all.write_text("950000\n")
    bootstrap_docker.give_real_time(of_all)
    assert (tmp_path / "docker" / "cpu.rt_runtime_us").read_text() == "900000"
    assert of_all.read_text() == "950000\n"


@pytest.mark.parametrize(("running", "is_kept"), [("containerd", True), ("python3", False), (None, False)])
def test_a_pid_file_whose_number_another_process_has_is_removed(
    tmp_path: Path, running: str | None, is_kept: bool
) -> None:
    (tmp_path / "4711").mkdir()
    if running:
        (tmp_path / "4711" / "comm").write_text(f"{running}\n")
    file = tmp_path / "containerd.pid"
    file.write_text("4711")
    bootstrap_docker.remove_stale_pid_files({"containerd": file, "dockerd": tmp_path / "docker.pid"}, tmp_path)
    assert file.exists() == is_kept
