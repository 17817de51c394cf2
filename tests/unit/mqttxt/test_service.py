"""What systemd is told of a role."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from mqttxt.core.service import Service


@pytest.fixture
def manager(tmp_path: Path) -> socket.socket:
    found = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    found.bind(str(tmp_path / "notify"))
    found.settimeout(1)
    return found


def test_it_says_that_the_role_runs_whether_it_is_ready_and_that_it_ends(manager: socket.socket) -> None:
    service = Service.of({"NOTIFY_SOCKET": manager.getsockname()})
    assert service is not None
    service.alive(False)
    service.alive(True)
    service.ending()
    assert manager.recv(200) == b"READY=1\nWATCHDOG=1\nSTATUS=not ready"
    assert manager.recv(200) == b"READY=1\nWATCHDOG=1\nSTATUS=ready"
    assert manager.recv(200).startswith(b"STOPPING=1\n")


def test_a_name_that_is_no_file_begins_with_a_zero_byte() -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind("\0mqttxt-test-service")
        Service("@mqttxt-test-service").alive(True)
        assert b"WATCHDOG=1" in manager.recv(200)


def test_without_systemd_nothing_is_said_and_who_does_not_listen_ends_nothing(tmp_path: Path) -> None:
    assert Service.of({}) is None
    Service(str(tmp_path / "nobody")).alive(True)
