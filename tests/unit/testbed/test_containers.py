"""Only one fleet flies at a time."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from testbed import containers
from testbed.containers import Containers
from testbed.errors import DockerError


class _Exec:
    """What runs a command in a container; the command speaks every millisecond, or its stream breaks."""

    def __init__(self, lines: list[bytes], code: int | None) -> None:
        self._lines, self._code = lines, code

    def exec_create(self, *_: object, **__: object) -> dict[str, str]:
        return {"Id": "1"}

    def exec_start(self, *_: object, **__: object) -> Iterator[bytes]:
        for line in self._lines:
            time.sleep(0.001)
            yield line

    def exec_inspect(self, _: str) -> dict[str, int | None]:
        return {"ExitCode": self._code}


def _containers(
    monkeypatch: pytest.MonkeyPatch, lines: list[bytes], code: int | None
) -> tuple[Containers, list[float]]:
    fleet = Containers.__new__(Containers)
    looked: list[float] = []
    monkeypatch.setattr(fleet, "_client", SimpleNamespace(api=_Exec(lines, code)), raising=False)
    monkeypatch.setattr(fleet, "_service", lambda _: SimpleNamespace(id="1"))
    monkeypatch.setattr(fleet, "check_alive", lambda: looked.append(time.monotonic()))
    return fleet, looked


def test_a_command_that_speaks_often_does_not_hide_a_container_that_died(monkeypatch: pytest.MonkeyPatch) -> None:
    fleet, looked = _containers(monkeypatch, [b"a\nb", b"c\n"] * 50, 0)
    said = list(fleet.execute("gs", ["mission"], alive_every_s=0.01))
    assert said == ["a", "bc"] * 50
    assert len(looked) > 3


def test_a_command_that_Docker_lost_sight_of_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    fleet, _ = _containers(monkeypatch, [b"a\n"], None)
    with pytest.raises(DockerError, match="gs: lost touch with mission, which still runs"):
        list(fleet.execute("gs", ["mission"]))


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
