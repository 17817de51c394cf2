"""`python3 -m tests.tools make | doctor`: what `make tools` calls, with the base system's Python alone."""

from __future__ import annotations

import sys

from testbed.bootstrap.steps import BootstrapError, print_rows

from .machine import ensure_machine, has_qemu, machine_is_current
from .programs import chromium, ensure_chromium, ensure_tshark, has_tshark, tshark_version


def make() -> None:
    """Install and make what is missing."""
    ensure_tshark()
    ensure_chromium()
    ensure_machine()


def doctor() -> None:
    """Print what is there, what is missing, and what to type."""
    print_rows(
        [
            ("tshark, for tests", has_tshark(), tshark_version() if has_tshark() else "", "apt-get install tshark"),
            ("Chromium, for tests", chromium() is not None, chromium() or "", "apt-get install chromium"),
            ("QEMU, for tests", has_qemu(), "", "apt-get install qemu-system-x86"),
            ("kernel for tests", machine_is_current(), ".cache/machine", "make tools"),
        ]
    )


def main() -> int:
    actions = {"make": make, "doctor": doctor}
    if len(sys.argv) != 2 or sys.argv[1] not in actions:
        print(f"usage: python3 -m tests.tools {' | '.join(actions)}", file=sys.stderr)
        return 2
    try:
        actions[sys.argv[1]]()
    except BootstrapError as error:
        print(f"tests: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    return 0


sys.exit(main())
