"""`python3 -m testbed.bootstrap venv | containers | doctor | lock | upgrade`: what `make` calls first."""

from __future__ import annotations

import shutil
import sys

from .docker import compose_command, daemon_answers, ensure_docker, version
from .images import BASE, IMAGES_NEED_MIB, NODE, ensure_images, has_image, node_is_current
from .steps import ROOT, check_python, command, print_rows
from .venv import ensure_venv, lock, upgrade, venv_is_current


def containers() -> None:
    """Make sure that Docker runs and that the images exist."""
    ensure_docker()
    ensure_images()


def doctor() -> None:
    """Print what is installed, what is missing, and the commands to type."""
    check_python()
    daemon = daemon_answers()
    compose = compose_command()
    rows = [
        ("Python", True, sys.version.split()[0], ""),
        ("virtual environment", venv_is_current(), ".venv", "make venv"),
        ("Docker daemon", daemon, version() if daemon else "", _docker_hint()),
        ("disk", _free_mib() >= IMAGES_NEED_MIB, f"{_free_mib()} MiB free", f"free {IMAGES_NEED_MIB} MiB of {ROOT}"),
        ("compose", compose is not None, " ".join(compose or ()), "apt-get install docker-compose"),
        ("base image", daemon and has_image(BASE), BASE, "make containers"),
        ("node image", daemon and node_is_current(), NODE, "make containers"),
    ]
    print_rows(rows)
    if not all(there for _, there, _, _ in rows):
        print("  make scenario-1 and make test get what is missing by themselves.")


def _free_mib() -> int:
    return shutil.disk_usage(ROOT).free // 2**20


def _docker_hint() -> str:
    if shutil.which("dockerd") is None:
        return "make containers (as root), or: sudo apt-get install docker.io docker-compose"
    return "make containers (as root), or: sudo systemctl start docker"


if __name__ == "__main__":
    actions = {"venv": ensure_venv, "containers": containers, "doctor": doctor, "lock": lock, "upgrade": upgrade}
    sys.exit(command("testbed.bootstrap", "testbed", actions))
