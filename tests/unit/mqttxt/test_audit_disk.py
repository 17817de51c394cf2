"""Audit logs on disks that are full, fail, or never answer: no command waits, and what is missing is written down."""

from __future__ import annotations

import json
import threading
import time
from itertools import chain, repeat
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mqttxt.core import audit_file, audit_log
from mqttxt.core import disk as disks
from mqttxt.core.audit_file import AuditFile
from mqttxt.core.audit_log import MOST_WAITING, AuditLog
from mqttxt.core.effects import Audit
from mqttxt.errors import AuditBroken, ConfigurationError
from mqttxt.protocol.commands import Arm
from mqttxt.security.audit_verdict import AuditVerdict, logs_of
from tests.rigs.faulty_disk import FaultyDisk
from tests.rigs.processes import wait_until
from tests.rigs.small_disk import SmallDisk
from tests.simulation.world import command_payload

AT_S = 1_800_000_000.0


def audit(seq: int) -> Audit:
    return Audit("command", command_payload(Arm(), seq=seq), seq, "gs-g", 1, True)


def lines(path: Path) -> list[dict[str, Any]]:
    """What a log has, if it is whole."""
    for files in logs_of([path]).values():
        AuditVerdict(None).read(files)
    return [json.loads(line) for file in logs_of([path])[path] for line in file.read_bytes().splitlines()]


def seqs(found: list[dict[str, Any]]) -> list[int]:
    return [line["said"]["seq"] for line in found if line["event"] == "command"]


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(audit_log, "RETRY_S", 0.02)
    monkeypatch.setattr(audit_log, "WRITE_S", 0.02)
    monkeypatch.setattr(audit_log, "SYNC_S", 0.02)


def test_a_full_disk_costs_no_record_and_the_gap_is_written(disk: SmallDisk, caplog: pytest.LogCaptureFixture) -> None:
    path = disk.folder / "log"
    log = AuditLog(path, "fog1", required=True)
    log.start(1)
    disk.fill()
    for seq in range(60):
        log.record(audit(seq))
    wait_until(lambda: not log.takes(), "it is noticed")
    log.record(audit(60))
    disk.make_room()
    wait_until(log.takes, "the disk takes it again")
    log.record(audit(61))
    log.close()
    found = lines(path)
    assert seqs(found) == list(range(62))
    (gap,) = [line for line in found if line["event"] == "gap"]
    assert gap["lost"] == 0
    assert gap["disk"] in ("No space left on device", "File too large")
    assert "commands are denied until it can be written" in caplog.text
    assert "can be written again; 0 records are lost" in caplog.text


def test_what_a_full_disk_keeps_waiting_is_bounded_and_what_is_lost_is_counted(
    disk: SmallDisk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(audit_log, "MOST_WAITING", 50)
    path = disk.folder / "log"
    disk.fill(to_the_brim=True)
    log = AuditLog(path, "fog1")
    log.start(1)
    wait_until(lambda: not log.takes(), "it is noticed")
    for seq in range(57):
        log.record(audit(seq))
    disk.make_room()
    wait_until(log.takes, "the disk takes it again")
    log.close()
    found = lines(path)
    assert seqs(found) == list(range(50))
    assert [line["lost"] for line in found if line["event"] == "gap"] == [7]


@pytest.mark.parametrize("was_there", [False, True])
def test_a_start_is_written_before_anything_is_said(tmp_path: Path, was_there: bool) -> None:
    if was_there:
        before = AuditLog(tmp_path / "log", "fog1")
        before.start(1)
        before.close()
    log = AuditLog(tmp_path / "log", "fog1")
    log.start(2)
    wait_until(lambda: b'"session":2' in (tmp_path / "log").read_bytes(), "it is in the file")
    log.close()


@pytest.mark.long
def test_no_command_waits_for_a_disk_that_does_not_answer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    answers, asked = threading.Event(), threading.Event()

    def never(file: int) -> None:
        asked.set()
        answers.wait(30)

    monkeypatch.setattr(audit_file.os, "fsync", never)
    monkeypatch.setattr(audit_log, "CLOSING_S", 0.05)
    log = AuditLog(tmp_path / "log", "fog1", required=True)
    log.start(1)
    log.record(audit(0))
    assert asked.wait(10)
    began = time.monotonic()
    for seq in range(1, 2 * MOST_WAITING):
        log.record(audit(seq))
    assert not log.takes()
    log.close()
    assert time.monotonic() - began < 5.0  # for all of them together; the disk has not answered one
    answers.set()
    wait_until(lambda: not log._thread.is_alive(), "it ends")
    found = lines(tmp_path / "log")
    kept = seqs(found)
    assert kept == list(range(len(kept)))
    assert sum(line["lost"] for line in found if line["event"] == "gap") == 2 * MOST_WAITING - len(kept)


FAULTS = st.sampled_from(["", "", "", "", "partly", "write", "sync", "open"])
STEPS = st.lists(st.sampled_from(["add", "add", "sync", "restart"]), max_size=30)


@given(STEPS, st.lists(FAULTS, max_size=60))
def test_whatever_fails_a_log_is_whole_and_has_what_was_synced(
    tmp_path_factory: pytest.TempPathFactory, steps: list[str], faults: list[str]
) -> None:
    path = tmp_path_factory.mktemp("faulty") / "log"
    must_have: list[int] = []
    added: list[int] = []
    with pytest.MonkeyPatch.context() as patch:
        faulty = FaultyDisk(chain(faults, repeat("")))
        patch.setattr(audit_file, "os", faulty)
        patch.setattr(disks, "os", faulty)
        file = AuditFile(path, "fog1", largest=900)
        for seq, step in enumerate([*steps, "add", "sync"]):
            if step == "restart":
                file.fail()
                file, added = AuditFile(path, "fog1", largest=900), []
                continue
            try:
                file.open(AT_S)
                if step == "add":
                    file.add(AT_S, "command", {"said": {"seq": seq}})
                    added.append(seq)
                    file.flush()
                else:
                    file.sync(AT_S)
                    must_have, added = must_have + added, []
            except OSError:
                file.fail()
        file.fail()
    found = seqs(lines(path)) if must_have else []
    assert sorted(set(found)) == found
    assert set(must_have) <= set(found)


@pytest.mark.long
def test_every_byte_that_is_changed_is_noticed(tmp_path: Path) -> None:
    """But in the last line: that may be one that was being written when the power went."""
    path = tmp_path / "log"
    file = AuditFile(path, "fog1")
    file.open(AT_S)
    for seq in range(3):
        file.add(AT_S, "command", {"seq": seq})
    file.sync(AT_S)
    whole = path.read_bytes()
    for place in range(whole.rindex(b"\n", 0, -1)):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        with pytest.raises((AuditBroken, ConfigurationError)):
            AuditVerdict(None).read([path])
