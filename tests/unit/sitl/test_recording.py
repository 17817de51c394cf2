"""What `sitl record` and `sitl compare` refuse, and what is left of a recording that breaks off."""

from __future__ import annotations

import gc
import socket
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from sitl.cli import app
from sitl.errors import SitlError
from sitl.likeness import subjects
from sitl.likeness.cases import CASES
from sitl.likeness.commands import RECORDINGS, record_into
from sitl.likeness.observer import Timeout
from sitl.likeness.pilot import Pilot
from sitl.likeness.procedures import Procedure
from sitl.likeness.recording import Case, Recording, load
from sitl.likeness.subjects import Simulated
from tests.rigs.processes import free_port

COPTER, PX4_MAIN = (str(RECORDINGS / name) for name in ("arducopter.json", "px4-main.json"))
DIES = "#!/bin/sh\necho no floating point\nexit 3\n"
SILENT = "#!/bin/sh\nexec sleep 600\n"


def _refused(*words: str) -> str:
    """The one line of a command that ends with 2."""
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 2
    assert result.output.count("\n") == 1
    return result.output


@pytest.mark.parametrize(
    ("options", "error"),
    [
        (["--stand-in", "copter"], "--stand-in 'copter': expected one of px4, ardupilot"),
        (["--stand-in", "px4", "--ardupilot-dir", "."], "expected one of --px4-dir FOLDER, --ardupilot-dir FOLDER and"),
        (["--stand-in", "ardupilot", "--instance", "250"], "--instance 250: expected 0 to 249"),
        (["--stand-in", "px4", "--case", "loop"], "--case 'loop': expected one of takeoff and land, "),
        (["--stand-in", "px4", "--case", "unasked"], "--case 'unasked': does not apply to px4: "),
        (["--stand-in", "px4", "--case", "idle, normal link"], "stand-in has no link 'normal'"),
    ],
)
def test_a_recording_that_cannot_be_is_one_line(tmp_path: Path, options: list[str], error: str) -> None:
    path = tmp_path / "x.json"
    assert error in _refused("record", str(path), *options)
    assert not path.exists()


def test_a_file_that_cannot_be_written_is_told_before_anything_flies(tmp_path: Path) -> None:
    stand_in = ["--stand-in", "ardupilot"]
    assert "its folder cannot be written to" in _refused("record", str(tmp_path / "no" / "x.json"), *stand_in)
    assert f"{tmp_path}: Is a directory" in _refused("record", str(tmp_path), *stand_in)


def test_a_recording_has_one_kind_of_autopilot() -> None:
    before = Path(PX4_MAIN).read_bytes()
    told = _refused("record", PX4_MAIN, "--stand-in", "ardupilot")
    assert "a recording like px4, and stand-in is like ardupilot" in told
    assert Path(PX4_MAIN).read_bytes() == before
    assert "a recording like ardupilot: expected one like px4" in _refused("compare", PX4_MAIN, COPTER)


def test_a_kind_that_nobody_knows_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    Recording("one", like="dji").save(path)
    assert "like 'dji': expected one of px4, ardupilot" in _refused("compare", str(path))


@pytest.fixture
def copter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of an autopilot that is made up, and that is recorded at ports that nobody else uses."""
    monkeypatch.setattr(subjects, "OWN", free_port(socket.SOCK_DGRAM))
    folder = tmp_path / "copter"
    folder.mkdir()
    (folder / "copter.parm").touch()
    (folder / "arducopter").write_text(SILENT)
    (folder / "arducopter").chmod(0o755)
    return folder


@pytest.mark.long
@pytest.mark.parametrize(
    ("program", "is_executable", "error"),
    [
        (DIES, True, "ArduCopter ended with 3: no floating point"),
        (DIES, False, "arducopter: Permission denied"),
        ("no program", True, "arducopter: Exec format error"),
        (SILENT, True, "ArduCopter does not say within 0.3 s that it could arm"),
    ],
)
def test_a_broken_autopilot_is_one_line_and_no_recording(
    tmp_path: Path, copter: Path, monkeypatch: pytest.MonkeyPatch, program: str, is_executable: bool, error: str
) -> None:
    monkeypatch.setattr(subjects, "STARTED_S", 0.3 if program == SILENT else 30.0)
    (copter / "arducopter").write_text(program)
    (copter / "arducopter").chmod(0o755 if is_executable else 0o644)
    assert error in _refused("record", str(tmp_path / "x.json"), "--ardupilot-dir", str(copter), "--instance", "0")
    assert list(tmp_path.iterdir()) == [copter]


@pytest.mark.long
def test_a_recording_that_fails_leaves_its_port_to_the_next_one(
    tmp_path: Path, copter: Path, monkeypatch: pytest.MonkeyPatch, no_collector: None
) -> None:
    monkeypatch.setattr(subjects, "STARTED_S", 0.1)
    for _ in range(2):
        said = _refused("record", str(tmp_path / "x.json"), "--ardupilot-dir", str(copter), "--instance", "0")
        assert "ArduCopter does not say within 0.1 s that it could arm" in said


@pytest.fixture
def no_collector() -> Iterator[None]:
    """Nothing is closed because Python found that nobody needs it any more."""
    gc.disable()
    yield
    gc.enable()


class _Ending(Simulated):
    """It ends by itself in the second case."""

    ended = False

    def check(self) -> None:
        if self.ended:
            raise SitlError("stand-in ended with -8: ")


def test_of_an_autopilot_that_ends_the_cases_before_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    subject, path = _Ending("ardupilot"), tmp_path / "x.json"

    def end(pilot: Pilot) -> None:
        subject.ended = True
        raise Timeout("armed: not within 10 s")

    _replace(monkeypatch, end)
    with pytest.raises(SitlError, match="ended with -8"):
        record_into(path, subject, ["parameters", "disarmed by itself"], lambda _: None)
    assert list(load(path).cases) == ["parameters"]


def test_a_case_that_does_not_come_to_its_end_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def wait(pilot: Pilot) -> None:
        pilot.until("armed", lambda: pilot.armed, 2)

    _replace(monkeypatch, wait)
    with pytest.raises(SitlError, match="stand-in: armed: not within 2 s"):
        record_into(tmp_path / "x.json", Simulated("ardupilot"), ["disarmed by itself"], lambda _: None)
    assert list(tmp_path.iterdir()) == []


def _replace(monkeypatch: pytest.MonkeyPatch, fly: Callable[[Pilot], None]) -> None:
    monkeypatch.setitem(CASES, "disarmed by itself", Procedure(fly))


def test_a_recording_is_replaced_at_once_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "x.json"
    Recording("one").save(path)

    def full(part: Path, *_: object, **__: object) -> int:
        part.touch()
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(SitlError, match=r"x\.json: No space left on device"):
        Recording("one", {"case": [Case(numbers={"a": 1.0})]}).save(path)
    assert load(path) == Recording("one")
    assert list(tmp_path.iterdir()) == [path]
