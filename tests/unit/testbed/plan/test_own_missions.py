"""A mission's file is looked at before anything is started for it, and is never run for that."""

from __future__ import annotations

from pathlib import Path

import pytest

from testbed.errors import UserError
from testbed.plan.own_missions import check_mission

WHAT = "expected a Python file with `async def mission(fleet, steps)`"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (b"", f": {WHAT}"),
        (b"def mission(fleet, steps): ...\n", f": {WHAT}"),
        (b"class A:\n    async def mission(self, steps): ...\n", f": {WHAT}"),
        (b"x = 1\nasync def mission(fleet): ...\n", f", line 2: {WHAT}"),
        (b"async def mission(fleet, steps)\n", ", line 1: expected ':'"),
        (b"\xff\xfe", "(unicode error) 'utf-8' codec can't decode byte 0xff"),
        (b"x = '\0'\n", "null bytes"),
        (b"# -*- coding: nope -*-\n", ": unknown encoding: nope"),
        (b"x = " + b"-" * 200_000 + b"1\n", f": {WHAT}: nested too deep"),
        (b"async def mission(fleet, steps, *, lake): ...\n", f", line 1: {WHAT}"),
    ],
)
def test_what_cannot_be_a_mission_is_one_line_with_its_place(tmp_path: Path, text: bytes, said: str) -> None:
    path = tmp_path / "mine.py"
    path.write_bytes(text)
    with pytest.raises(UserError) as error:
        check_mission(path)
    assert str(error.value).startswith(str(path))
    assert said in str(error.value)
    assert "\n" not in str(error.value)


def test_a_folder_is_no_mission(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"mission\(fleet, steps\)`: Is a directory$"):
        check_mission(tmp_path)


def test_the_file_is_not_run_for_it(tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    path.write_text("raise SystemExit\nasync def mission(fleet, steps): ...\n")
    check_mission(path)
