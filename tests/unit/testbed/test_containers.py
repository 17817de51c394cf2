"""Only one fleet flies at a time."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from testbed import containers
from testbed.errors import DockerError


def test_a_second_run_is_told_who_flies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(containers, "LOCK", tmp_path / "lock")
    program = (
        "import sys, pathlib; from testbed import containers; containers.LOCK = pathlib.Path(sys.argv[1]);"
        "containers.only_run(); print('flying', flush=True); sys.stdin.read()"
    )
    command = [sys.executable, "-c", program, str(tmp_path / "lock")]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as first:
        assert first.stdout is not None
        assert first.stdin is not None
        assert first.stdout.readline() == "flying\n"
        with pytest.raises(DockerError, match=rf"another run is going on \(process {first.pid}\)"):
            containers.only_run()
        first.stdin.close()
    containers.only_run()
