"""Programs that only the tests need: installed where they are missing."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tests.tools import programs


@pytest.mark.parametrize(
    ("ensure", "program", "package"),
    [(programs.ensure_tshark, "tshark", "tshark"), (programs.ensure_chromium, "google-chrome", "chromium")],
)
def test_a_program_is_installed_only_where_it_has_no_name(
    ensure: Callable[[], object], program: str, package: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[list[str]] = []
    monkeypatch.setattr(programs, "apt_install", lambda packages, why: asked.append(packages))
    monkeypatch.setattr(programs.shutil, "which", lambda name: "/usr/bin/it" if name == program else None)
    ensure()
    assert asked == []
    monkeypatch.setattr(programs.shutil, "which", lambda _: None)
    ensure()
    assert asked == [[package]]


def test_tsharks_version_is_found_behind_what_it_tells_root(monkeypatch: pytest.MonkeyPatch) -> None:
    said = 'Running as user "root" and group "root". This could be dangerous.\nTShark (Wireshark) 4.4.7 (Git v4).\n'
    monkeypatch.setattr(programs, "run", lambda _: said)
    assert programs.tshark_version() == "4.4.7"
