"""A pytest that a test runs in a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path


def inner_environment(**more: str) -> dict[str, str]:
    """The environment without the outer pytest's options and worker.

    With the outer options the inner pytest would wait for the outer workers (`-n`) on shared locks and overwrite the
    report (`--junitxml`); with the outer worker's name it would be a worker itself.
    """
    own = {name: value for name, value in os.environ.items() if not name.startswith(("PYTEST_ADDOPTS", "PYTEST_XDIST"))}
    return own | more


def run_pytest(folder: Path, *options: str, timeout_s: float | None = None) -> subprocess.CompletedProcess[str]:
    """Run pytest in a folder without the outer one's options. Raises TimeoutExpired."""
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *options]
    return subprocess.run(
        command, cwd=folder, env=inner_environment(), capture_output=True, text=True, check=False, timeout=timeout_s
    )
