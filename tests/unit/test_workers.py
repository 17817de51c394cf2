"""How `make test` shares out tests: a file stays on one worker, and what is to be alone runs last, one at a time."""

from __future__ import annotations

import json
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest

TESTS_OWN = [Path(__file__).parents[1] / name for name in ("conftest.py", "lateness.py")]
WORDS = ["--numprocesses", "3", "--dist", "loadfile", "--no-loadscope-reorder", "-p", "no:cacheprovider"]
TESTS = """
import json, os, time
from pathlib import Path
import pytest

MARKS
@pytest.mark.parametrize("n", range(4))
def test_some(n):
    began_ns = time.monotonic_ns()
    sum(range(100_000))
    ran = [Path(__file__).stem, os.environ["PYTEST_XDIST_WORKER"], began_ns, time.monotonic_ns()]
    with (Path(__file__).parent / "log").open("a") as log:
        log.write(json.dumps(ran) + chr(10))
"""
FILES = {"test_a": "", "test_b": "", "test_c": "", "test_d": "", "test_x": "alone", "test_y": "e2e", "test_z": "alone"}


@pytest.mark.long
def test_a_file_is_on_one_worker_and_what_is_alone_runs_last_beside_nothing(tmp_path: Path) -> None:
    for own in TESTS_OWN:
        (tmp_path / own.name).write_text(own.read_text())
    (tmp_path / "pyproject.toml").write_text('[tool.pytest.ini_options]\nmarkers = ["alone: a", "e2e: b"]\n')
    for name, mark in FILES.items():
        (tmp_path / f"{name}.py").write_text(TESTS.replace("MARKS", f"@pytest.mark.{mark}" if mark else ""))
    command = [sys.executable, "-m", "pytest", *WORDS]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    ran = [json.loads(line) for line in (tmp_path / "log").read_text().splitlines()]
    assert len(ran) == 4 * len(FILES)
    assert len({(name, worker) for name, worker, *_ in ran}) == len(FILES)
    alone = sorted((began, ended) for name, _, began, ended in ran if FILES[name])
    others = [ended for name, _, _, ended in ran if not FILES[name]]
    assert alone[0][0] >= max(others)
    assert all(after[0] >= before[1] for before, after in pairwise(alone))
