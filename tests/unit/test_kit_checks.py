"""What the kit finds otherwise than expected beside others is checked again by itself, and judged by that."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import pytest

from mqttxt_conformance.registry import Finding, Rule, Verdict
from tests.rigs.kit_checks import MOST_AGAIN, Checked, Expected, check, said

SOUND, BROKEN = "sound", "broken"
EXPECTED = {SOUND: Expected(set(), {"left"}), BROKEN: Expected({"rule"})}


async def _nothing(kit: object) -> str:
    return ""


def _found(**verdicts: Verdict) -> list[Finding]:
    return [Finding(Rule("uav", name, (), "", _nothing), verdict, name) for name, verdict in verdicts.items()]


AS_EXPECTED = {
    SOUND: _found(rule=Verdict.PASS, left=Verdict.NOT_TESTED),
    BROKEN: _found(rule=Verdict.FAIL, other=Verdict.PASS),
}


class Finder:
    """Finds one thing beside others and another alone."""

    def __init__(self, together: dict[str, list[Finding]], alone: dict[str, list[Finding]]) -> None:
        self.runs = [together, alone]
        self.asked: list[tuple[str, set[str], int]] = []

    def __call__(self, folder: Path, names: Collection[str], at_once: int) -> dict[str, list[Finding]]:
        self.asked.append((folder.name, {*names}, at_once))
        return {name: self.runs[len(self.asked) - 1][name] for name in names}


def _check(finder: Finder, folder: Path, expected: dict[str, Expected] = EXPECTED) -> Checked:
    return check(finder, folder, expected, 16)


def test_what_is_as_expected_is_checked_once(tmp_path: Path) -> None:
    finder = Finder(AS_EXPECTED, {})
    assert _check(finder, tmp_path) == Checked(AS_EXPECTED, {})
    assert finder.asked == [("together", {SOUND, BROKEN}, 16)]


@pytest.mark.parametrize(
    ("name", "otherwise"),
    [
        (SOUND, _found(rule=Verdict.FAIL, left=Verdict.NOT_TESTED)),
        (SOUND, _found(rule=Verdict.NOT_TESTED, left=Verdict.NOT_TESTED)),
        (SOUND, _found(rule=Verdict.PASS, left=Verdict.PASS)),
        (BROKEN, _found(rule=Verdict.PASS, other=Verdict.PASS)),
        (BROKEN, _found(rule=Verdict.FAIL, other=Verdict.FAIL)),
    ],
)
def test_what_is_otherwise_beside_others_is_checked_again_alone_and_said(
    tmp_path: Path, name: str, otherwise: list[Finding]
) -> None:
    finder = Finder({**AS_EXPECTED, name: otherwise}, AS_EXPECTED)
    checked = _check(finder, tmp_path)
    assert finder.asked[1:] == [("alone", {name}, 1)]
    assert checked == Checked(AS_EXPECTED, {name: str(said(otherwise, Verdict.FAIL))})


def test_what_is_otherwise_alone_too_stays_so(tmp_path: Path) -> None:
    otherwise = {**AS_EXPECTED, BROKEN: _found(rule=Verdict.PASS)}
    finder = Finder(otherwise, otherwise)
    assert _check(finder, tmp_path).found == otherwise


def test_where_many_are_otherwise_none_is_checked_again(tmp_path: Path) -> None:
    names = [f"uav-{number}" for number in range(MOST_AGAIN + 1)]
    expected = {name: Expected({"rule"}) for name in names}
    finder = Finder({name: _found(rule=Verdict.PASS) for name in names}, {})
    assert _check(finder, tmp_path, expected).beside_others == {}
    assert len(finder.asked) == 1
