"""`python3 -m tests.tools make | doctor`: what `make tools` calls, with the base system's Python alone."""

from __future__ import annotations

import shutil
import sys

from testbed.bootstrap.steps import command, print_rows

from .axe import AXE, ensure_axe
from .machine import ensure_machine, has_qemu, machine_is_current
from .node_programs import ensure_node_programs, node_programs_are_current
from .programs import chromium, ensure_checkers, ensure_chromium, ensure_tshark, has_tshark, tshark_version


def make() -> None:
    """Install and make what is missing."""
    ensure_tshark()
    ensure_checkers()
    ensure_chromium()
    ensure_axe()
    ensure_node_programs()
    ensure_machine()


def doctor() -> None:
    """Print what is there, what is missing, and what to type."""
    print_rows(
        [
            ("tshark, for tests", has_tshark(), tshark_version() if has_tshark() else "", "apt-get install tshark"),
            ("systemd, for tests", shutil.which("systemd-analyze") is not None, "", "apt-get install systemd"),
            ("kubectl, for tests", shutil.which("kubectl") is not None, "", "apt-get install kubernetes-client"),
            ("Chromium, for tests", chromium() is not None, chromium() or "", "apt-get install chromium"),
            ("axe-core, for tests", AXE.exists(), AXE.name, "make tools"),
            ("the nodes' programs", node_programs_are_current(), ".cache/node-programs", "make tools"),
            ("QEMU, for tests", has_qemu(), "", "apt-get install qemu-system-x86"),
            ("kernel for tests", machine_is_current(), ".cache/machine", "make tools"),
        ]
    )


if __name__ == "__main__":
    sys.exit(command("tests.tools", "tests", {"make": make, "doctor": doctor}))
