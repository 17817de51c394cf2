"""Programs that only the tests need: installed where they are missing."""

from __future__ import annotations

import pytest

from tests.tools import programs


def test_tshark_is_installed_only_where_it_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[list[str]] = []
    monkeypatch.setattr(programs, "apt_install", lambda packages, why: asked.append(packages))
    monkeypatch.setattr(programs.shutil, "which", lambda _: "/usr/bin/tshark")
    programs.ensure_tshark()
    assert asked == []
    monkeypatch.setattr(programs.shutil, "which", lambda _: None)
    programs.ensure_tshark()
    assert asked == [["tshark"]]


def test_chromium_is_installed_only_where_it_has_no_name(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[list[str]] = []
    monkeypatch.setattr(programs, "apt_install", lambda packages, why: asked.append(packages))
    monkeypatch.setattr(programs.shutil, "which", lambda name: "/usr/bin/it" if name == "google-chrome" else None)
    programs.ensure_chromium()
    assert asked == []
    monkeypatch.setattr(programs.shutil, "which", lambda _: None)
    programs.ensure_chromium()
    assert asked == [["chromium"]]


def test_tsharks_version_is_found_behind_what_it_tells_root(monkeypatch: pytest.MonkeyPatch) -> None:
    said = 'Running as user "root" and group "root". This could be dangerous.\nTShark (Wireshark) 4.4.7 (Git v4).\n'
    monkeypatch.setattr(programs, "run", lambda _: said)
    assert programs.tshark_version() == "4.4.7"
