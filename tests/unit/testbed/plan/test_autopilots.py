"""Where a real autopilot is found, and what is said of a folder that is none."""

from __future__ import annotations

import platform
from pathlib import Path

import pytest
from typer.testing import CliRunner

from testbed.cli import commands as cli
from testbed.errors import UserError
from testbed.plan.overrides import chosen
from tests.handmade.autopilot_folders import PX4, make_folder


def test_a_folder_is_told_to_compose_by_its_whole_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_folder(tmp_path / "px4")
    monkeypatch.chdir(tmp_path)
    assert chosen({"AUTOPILOT": "px4", "PX4_DIR": "px4"}) == {"AUTOPILOT": "px4", "AUTOPILOT_DIR": f"{tmp_path}/px4"}


def test_of_an_ardupilot_there_is_no_image_that_could_be_had() -> None:
    with pytest.raises(UserError, match=r"ARDUPILOT_DIR: not set; expected a folder with arducopter, copter\.parm"):
        chosen({"AUTOPILOT": "ardupilot"})
    assert chosen({"AUTOPILOT": "ardupilot", "ARDUPILOT_IMAGE": "mine:1"})["AUTOPILOT_IMAGE"] == "mine:1"


def test_without_a_folder_it_is_in_an_image() -> None:
    assert chosen({"AUTOPILOT": "px4"})["AUTOPILOT_IMAGE"] == "px4io/px4-sitl:v1.17.0"
    assert chosen({"AUTOPILOT": "px4", "PX4_DIR": "", "PX4_IMAGE": "mine:1"})["AUTOPILOT_IMAGE"] == "mine:1"


@pytest.mark.parametrize(
    ("broken", "said"),
    [
        ("rm -r .", "expected a folder, with bin/px4 in it"),
        ("rm bin/px4", "no bin/px4; expected bin/px4 and what belongs to it"),
        ("rm etc/init.d-posix/rcS", "no etc/init.d-posix/rcS; expected bin/px4 and what belongs to it"),
        ("chmod -x bin/px4", "bin/px4 is not executable; type: chmod +x {folder}/bin/px4"),
        ("text", "bin/px4 is built for something else; expected a Linux program for {here}"),
        ("machine", "bin/px4 is built for {other}; expected a Linux program for {here}"),
    ],
)
def test_what_is_wrong_with_a_folder_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, broken: str, said: str
) -> None:
    here = platform.machine()
    other = "aarch64" if here == "x86_64" else "x86_64"
    folder = make_folder(tmp_path / "px4", PX4, other if broken == "machine" else "")
    action, _, name = broken.partition(" ")
    if action == "rm" and name.startswith("-r"):
        folder = tmp_path / "none"
    elif action == "rm":
        (folder / name).unlink()
    elif action == "chmod":
        monkeypatch.setattr("testbed.plan.autopilots.os.access", lambda *_: False)  # whoever is root may always
    elif action == "text":
        (folder / PX4.program).write_text("#!/bin/sh\necho not a program of this machine\n")
    monkeypatch.setenv("AUTOPILOT", "px4")
    monkeypatch.setenv("PX4_DIR", str(folder))
    result = CliRunner().invoke(cli.app, ["run", "scenario-1", "--results", str(tmp_path / "results")])
    assert result.exit_code == 2
    assert result.stderr == f"testbed: PX4_DIR={folder}: {said.format(folder=folder, here=here, other=other)}\n"
    assert not (tmp_path / "results").exists()


def test_an_empty_program_is_none_of_this_machine(tmp_path: Path) -> None:
    folder = make_folder(tmp_path)
    (folder / PX4.program).write_bytes(b"")
    with pytest.raises(UserError, match="built for something else"):
        PX4.check(folder, "PX4_DIR=x")
