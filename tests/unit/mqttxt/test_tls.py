"""Session keys for measurements: written where SSLKEYLOGFILE says, never without a word."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

from mqttxt.core.mqtt import tls
from mqttxt.security.authority import Authority
from mqttxt.security.identity import Identity


@pytest.fixture
def identity(tmp_path: Path) -> Identity:
    return Identity.load(Authority.create(tmp_path / "acme", "acme").issue("drone1"))


def test_without_the_variable_no_session_keys_are_written(identity: Identity, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SSLKEYLOGFILE", raising=False)
    assert tls.client_context(identity).keylog_filename is None
    monkeypatch.setenv("SSLKEYLOGFILE", "")
    assert tls.client_context(identity).keylog_filename is None


def test_session_keys_are_logged_with_one_warning(
    identity: Identity, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    path = str(tmp_path / "keys.log")
    monkeypatch.setenv("SSLKEYLOGFILE", path)
    with caplog.at_level(logging.WARNING):
        contexts = [tls.client_context(identity) for _ in range(2)]
    assert [context.keylog_filename for context in contexts] == [path, path]
    assert [record.getMessage() for record in caplog.records] == [
        f"SSLKEYLOGFILE: session keys are written to {path}; who has them can decrypt this node's traffic"
    ]


def test_a_file_for_session_keys_that_cannot_be_written_is_named(
    identity: Identity, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SSLKEYLOGFILE", str(tmp_path / "nowhere" / "keys.log"))
    with pytest.raises(OSError, match=r"SSLKEYLOGFILE .*/nowhere/keys.log: No such file or directory"):
        tls.client_context(identity)
