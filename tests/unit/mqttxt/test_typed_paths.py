"""Paths that a person types: what cannot be read or written is one line, and no link, pipe or folder is replaced."""

from __future__ import annotations

import os
import shlex
import socket
from collections.abc import Callable
from pathlib import Path

import pytest

from mqttxt import ConfigurationError, Parameter, Parameters, ParameterType, Plan
from mqttxt.cli import station
from mqttxt.protocol.parameters import ParameterSet
from mqttxt.protocol.plans import PlanObject
from mqttxt.security.files import named_by_user
from tests.unit.mqttxt.typed import refused

LONG = "x" * 256
SAVES: list[Callable[[Path], None]] = [
    Plan(PlanObject()).save,
    Parameters(ParameterSet.of([Parameter("A", ParameterType.INT32, 1)])).save,
]
WRITES = ["plan download {}", "params save {}", "logs get 1 {}"]


@pytest.mark.parametrize(
    "typed",
    [
        "gs send arm --identity {}",
        "activator --fog 1 --cloud mqtt://127.0.0.1:1 --identity {}",
        "broker cloud --out files --identity {}",
        "conformance broker mqtts://127.0.0.1:1 --identity {}",
        "conformance uav --broker mqtts://127.0.0.1:1 --fleet {}",
        "keys show {}",
        "keys show --fleet {}",
        "keys check {}",
        "keys renew drone1 --fleet {}",
        "keys mavlink {}",
        "keys mavlink {} --install serial:/nowhere:57600 --drone 1",
        "uav --drone 1 --broker mqtt://127.0.0.1:1 --journal {}",
        "activator --fog 1 --cloud mqtt://127.0.0.1:1 --fog-broker mqtt://127.0.0.1:1 --ready-file {}/below",
        *(f"gs {words} --drone 1" for words in WRITES),
    ],
)
@pytest.mark.parametrize("path", [LONG, f"{LONG}/below"])
def test_a_name_that_is_too_long_is_one_line(typed: str, path: str) -> None:
    said = refused(*shlex.split(typed.format(path)))
    assert LONG in said
    assert ": File name too long; expected " in said


@pytest.fixture
def odd(tmp_path: Path) -> Path:
    """A folder with a pipe, a socket and a folder, and links to them and to nowhere."""
    os.mkfifo(tmp_path / "pipe")
    with socket.socket(socket.AF_UNIX) as there:
        there.bind(str(tmp_path / "socket"))
    (tmp_path / "folder").mkdir()
    for name in ("pipe", "folder", "loop", "none/file"):
        (tmp_path / f"to_{name.replace('/', '_')}").symlink_to("to_loop" if name == "loop" else name)
    return tmp_path


ODD = {
    "pipe": "not a regular file",
    "socket": "not a regular file",
    "to_pipe": "not a regular file",
    "folder": "is a folder",
    "to_folder": "is a folder",
    "to_loop": "Too many levels of symbolic links",
    "none/file": "no such folder",
    "to_none_file": "no such folder",
    "socket/file": "Not a directory",
}


@pytest.mark.parametrize(("name", "why"), ODD.items())
def test_what_is_no_file_is_not_replaced(odd: Path, name: str, why: str) -> None:
    before = {path: path.lstat() for path in odd.iterdir()}
    for save in SAVES:
        with pytest.raises(ConfigurationError) as said:
            save(odd / name)
        assert str(said.value) == f"{odd / name}: {why}; expected a file in a folder that exists"
    assert {path: path.lstat() for path in odd.iterdir()} == before


@pytest.mark.parametrize("words", WRITES)
@pytest.mark.parametrize("name", ["pipe", "to_folder", "none/file"])
def test_no_station_connects_for_a_file_that_cannot_be_written(
    odd: Path, words: str, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def connect(*_: object) -> None:
        raise AssertionError("a station was made")

    monkeypatch.setattr(station, "run_with_drone", connect)
    said = refused("gs", *words.format(odd / name).split(), "--drone", 1)
    assert said == f"{odd / name}: {ODD[name]}; expected a file in a folder that exists"


@pytest.mark.parametrize("is_there", [True, False])
def test_a_link_stays_one_and_the_file_is_where_it_leads(tmp_path: Path, is_there: bool) -> None:
    target, link = tmp_path / "target", tmp_path / "link"
    link.symlink_to("target")
    for save in SAVES:
        if is_there:
            target.write_text("before")
        save(link)
        assert link.is_symlink()
        assert len(target.read_text()) > 10
        target.unlink()


def test_a_path_that_is_no_link_stays_as_it_was_typed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert named_by_user(Path("new.plan")) == Path("new.plan")
