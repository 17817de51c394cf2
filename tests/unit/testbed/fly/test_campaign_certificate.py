"""The certificate of a campaign, and what is said where it, or the scheduler's address, is wrong."""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from testbed.errors import UserError
from testbed.fly.campaign import certificate
from testbed.fly.campaign.certificate import check_scheduler, make_certificate, security_of


@pytest.fixture
def made(tmp_path: Path) -> Path:
    path = tmp_path / "campaign.pem"
    make_certificate(path)
    return path


def test_it_is_the_owners_alone_and_every_role_has_it(made: Path) -> None:
    assert made.stat().st_mode & 0o777 == 0o600
    security = security_of(made)
    assert security.require_encryption
    for role in ("client", "scheduler", "worker"):
        assert {"ssl_context", "require_encryption"} <= set(security.get_connection_args(role))


def test_one_that_is_there_is_not_overwritten(made: Path) -> None:
    before = made.read_bytes()
    with pytest.raises(UserError, match="File exists; expected a new file"):
        make_certificate(made)
    assert made.read_bytes() == before


def test_one_that_is_missing_says_what_makes_it(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"campaign\.pem: No such file or directory; .*`make certificate` makes it"):
        security_of(tmp_path / "campaign.pem")


def test_one_that_others_can_read_is_refused(made: Path) -> None:
    made.chmod(0o644)
    with pytest.raises(UserError, match=r"others can read it; type: chmod 600"):
        security_of(made)


@pytest.mark.parametrize("text", ["", "hello", "-----BEGIN CERTIFICATE-----\n"])
def test_one_that_is_none_is_refused(made: Path, text: str) -> None:
    made.write_text(text)
    with pytest.raises(UserError, match="no certificate with its key"):
        security_of(made)


def test_one_that_has_expired_is_refused(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Later:
        @staticmethod
        def now(zone: object) -> datetime:
            return datetime.now(UTC) + timedelta(days=400)

    monkeypatch.setattr(certificate, "datetime", Later)
    with pytest.raises(UserError, match=r"expired at \d{4}-\d\d-\d\d; remove it"):
        security_of(made)


@pytest.mark.parametrize("address", ["lab:8786", "tcp://lab:8786", "tls://lab", "tls://:8786", "tls://a b:1", ""])
def test_an_address_that_is_none_is_refused(made: Path, address: str) -> None:
    with pytest.raises(UserError, match=re.escape(f"SCHEDULER={address}: expected tls://HOST:PORT")):
        check_scheduler(address, security_of(made))


def test_an_address_where_nobody_is_is_said(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(certificate, "ANSWERS_S", 0.1)
    with pytest.raises(UserError, match=r"SCHEDULER=tls://127\.0\.0\.1:1: no scheduler answers"):
        check_scheduler("tls://127.0.0.1:1", security_of(made))
