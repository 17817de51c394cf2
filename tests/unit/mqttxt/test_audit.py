"""What roles write into their audit logs, and that no change of a log goes unnoticed (section 14)."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from mqttxt.cli.main import app
from mqttxt.core.audit_file import AuditFile
from mqttxt.core.audit_log import AuditLog
from mqttxt.core.effects import Audit
from mqttxt.errors import ConfigurationError
from mqttxt.protocol.commands import Arm, Goto, Hold, Land
from mqttxt.protocol.messages import FogResultMessage, ResultMessage, Word
from mqttxt.protocol.rankings import SelectMessage
from mqttxt.security.audit_chain import Link
from mqttxt.security.identity import Identity
from mqttxt.security.rights import Rights
from mqttxt.security.seal import Seal
from tests.simulation.fogs import BORN_MS, ready
from tests.simulation.signing import authority, folder, seal
from tests.simulation.world import GS_SESSION, World, ack, command_payload, heartbeat

AT_S = 1_800_000_000.0


def identity(node: str = "fog1") -> Identity:
    return Identity.load(folder(node, Rights(), "acme"))


# What is written down.


def told(world: World, name: str) -> list[tuple[str, str | None, int | None, bool, str]]:
    """What a role has written: event, who, drone, signed, and the command or the word."""
    return [
        (audit.event, audit.who, audit.drone, audit.is_signed, _what(audit.message))
        for role, audit in world.audited
        if role == name
    ]


def _what(message: Any) -> str:
    return message.word.label if isinstance(message, ResultMessage) else message.command.name


@pytest.mark.parametrize("signed", [False, True])
def test_both_nodes_write_who_commanded_what_and_its_last_word(signed: bool) -> None:
    world = World(signed=signed).start()
    world.pass_time(1000)
    world.send(Arm())
    world.autopilot(ack(400), heartbeat(armed=True))
    word = ("word", "drone1", 1, signed, "completed")
    assert told(world, "activator") == [("command", "gs-g", 1, signed, "arm"), word]
    assert told(world, "uav") == [("command", "gs-g" if signed else None, 1, signed, "arm"), word]


def test_a_broadcast_is_one_command_and_a_word_of_each_drone() -> None:
    bench = ready(drones=(1, 2))
    bench.command(Land(), to="commands")
    assert [(a.event, a.who, a.drone) for a in bench.audited] == [("command", "gs-alpha", None), ("word", "fog1", 2)]
    unreachable = bench.audited[1].message
    assert isinstance(unreachable, ResultMessage)
    assert unreachable.word is Word.UNREACHABLE


def test_a_choice_of_a_drone_is_written_as_it_was_asked_for() -> None:
    bench = ready()
    bench.select(Goto(latitude_deg=47.0, longitude_deg=8.0, altitude_m=10.0))
    select, denied = bench.audited
    assert (select.event, select.who, select.drone) == ("select", "gs-alpha", None)
    assert isinstance(select.message, SelectMessage)
    assert (denied.event, denied.who, denied.drone) == ("word", "fog1", None)
    assert isinstance(denied.message, FogResultMessage)


def test_the_truth_behind_an_unconfirmed_is_written_too() -> None:
    bench = ready()
    bench.command(deadline_ms=BORN_MS + 1000, limit_s=1.0)
    bench.until(BORN_MS + 9000)
    bench.result(Word.COMPLETED)
    bench.result(Word.COMPLETED)
    words = [audit.message for audit in bench.audited if isinstance(audit.message, ResultMessage)]
    assert [(word.word, word.settled) for word in words] == [(Word.UNCONFIRMED, None), (Word.COMPLETED, True)]


def test_who_is_not_in_control_is_written_and_a_repetition_is_not() -> None:
    bench = ready(controlled=False)
    for _ in range(3):
        bench.command(deadline_ms=BORN_MS + 5000)
    command, denied = bench.audited
    assert (command.who, denied.who) == (None, "fog1")
    assert isinstance(denied.message, ResultMessage)
    assert (denied.message.word, denied.message.reason) == (Word.DENIED, "not_in_control")


def test_what_a_drone_closes_at_its_next_start_is_written() -> None:
    world = World().start()
    world.pass_time(1000)
    world.send(Arm())
    world.audited.clear()
    world.restart_uav(0x44, list(world.disk.unfinished.values()))
    assert ("word", "drone1", 1, False, "unconfirmed") in told(world, "uav")


# A log that is required.


def test_a_fog_denies_what_it_cannot_write_down_except_what_halts_a_drone() -> None:
    bench = ready()
    bench.role.relay.is_audited = lambda: False
    bench.command()
    denied = bench.audited[-1].message
    assert isinstance(denied, ResultMessage)
    assert (denied.word, denied.reason) == (Word.DENIED, "audit")
    (forwarded,) = bench.command(Hold(), seq=2)
    assert forwarded.topic == "drone1/commands"


def test_a_drone_denies_what_it_cannot_write_down_except_what_halts_it() -> None:
    world = World().start()
    world.pass_time(1000)
    world.uav.desk.is_audited = lambda: False
    world.send(Arm())
    assert not world.wrote
    assert told(world, "uav")[-1][4] == "denied"
    world.send(Hold())
    assert len(world.wrote) == 1


# Whether a log is whole.


def written(path: Path, node: str = "fog1", signed: bool = True, largest: int = 10**6, count: int = 20) -> Path:
    """A log of `count` lines beside what begins each file, signed behind every fifth."""
    file = AuditFile(path, node, largest)
    for seq in range(count):
        file.open(AT_S)
        file.add(AT_S + seq, "command", {"who": "gs-g", "seq": seq})
        if signed and seq % 5 == 4:
            file.sign(AT_S + seq, seal(node))
        file.sync(AT_S + seq)
    file.fail()
    return path


def verify(*arguments: str | Path) -> tuple[int, str]:
    done = CliRunner().invoke(app, ["audit", "verify", *map(str, arguments)])
    assert len(done.output.splitlines()) == 1
    return done.exit_code, done.output


def acme() -> Path:
    return authority("acme").folder


def says(path: Path, code: int, words: str) -> None:
    """What is said of a log whose fleet is known, and the exit code."""
    exit_code, said = verify(path, "--fleet", acme())
    assert words in said
    assert exit_code == code


def test_a_whole_log_says_whose_it_is_and_of_when(tmp_path: Path) -> None:
    code, said = verify(written(tmp_path / "log"), "--fleet", acme())
    assert code == 0
    assert "25 lines of fog1 are whole, 2027-01-15T08:00:00.000Z to 2027-01-15T08:00:19.000Z" in said
    assert "signed by fog1 of fleet acme to 2027-01-15T08:00:19.000Z" in said


def test_without_a_fleet_it_says_that_signatures_were_not_looked_at(tmp_path: Path) -> None:
    assert "signatures were not looked at (--fleet)" in verify(written(tmp_path / "log", signed=False))[1]
    says(tmp_path / "log", 1, "no line is signed; expected signatures of fleet acme")


def changed(line: int, old: bytes, new: bytes) -> Callable[[list[bytes]], list[bytes]]:
    return lambda lines: [each.replace(old, new) if n == line else each for n, each in enumerate(lines, start=1)]


TAMPERED: dict[str, tuple[Callable[[list[bytes]], list[bytes]], int]] = {
    "changed": (changed(8, b"gs-g", b"gs-x"), 8),
    "another time": (changed(9, b"2027", b"2026"), 9),
    "a hash of its own": (changed(8, b'"hash":"', b'"hash":"0'), 8),
    "removed": (lambda lines: lines[:7] + lines[8:], 8),
    "moved": (lambda lines: [*lines[:7], lines[8], lines[7], *lines[9:]], 8),
    "repeated": (lambda lines: [*lines[:8], *lines[7:]], 9),
    "the beginning is missing": (lambda lines: lines[3:], 1),
    "garbage between": (lambda lines: [*lines[:7], b"\0" * 80, *lines[7:]], 8),
    "an empty line between": (lambda lines: [*lines[:7], b"", *lines[7:]], 8),
    "very long": (lambda lines: [*lines[:7], b"x" * 1_100_000, *lines[7:]], 8),
}


@pytest.mark.parametrize("how", TAMPERED)
def test_the_first_line_that_is_not_as_it_was_written_is_named(tmp_path: Path, how: str) -> None:
    tamper, line = TAMPERED[how]
    path = written(tmp_path / "log")
    path.write_bytes(b"\n".join(tamper(path.read_bytes().split(b"\n"))))
    code, said = verify(path, "--fleet", acme())
    assert code == 1
    assert f"{path}: line {line}: " in said
    if line > 7:
        assert "lines of fog1 are whole" in said
        assert "signed by fog1 of fleet acme to 2027-01-15T08:00:04.000Z" in said


def chained(path: Path, change: Callable[[dict[str, Any]], dict[str, Any]]) -> None:
    """What an adversary makes of a log who can write the file and computes every hash anew."""
    link, out = Link(), b""
    for line in path.read_bytes().splitlines():
        fields = change(json.loads(line))
        link, made = link.next(AT_S, fields["event"], {k: fields[k] for k in fields if k not in ("n", "event", "hash")})
        out += made
    path.write_bytes(out)


def test_who_computes_the_hashes_anew_cannot_sign(tmp_path: Path) -> None:
    path = written(tmp_path / "log")
    chained(path, lambda fields: {**fields, "who": "gs-x"} if fields.get("seq") == 7 else fields)
    says(path, 1, f"{path}: line 13: fog1 has signed another line")


@pytest.mark.parametrize(
    ("by", "why"),
    [
        (lambda: seal("drone2"), "signed by drone2; expected fog1, whose log it is"),
        (lambda: seal("fog1", fleet="other"), "whom the authority of fleet acme does not know"),
    ],
)
def test_who_signs_with_another_key_is_named(tmp_path: Path, by: Callable[[], Seal], why: str) -> None:
    file = AuditFile(tmp_path / "log", "fog1")
    file.open(AT_S)
    file.sign(AT_S, by())
    file.sync(AT_S)
    code, said = verify(tmp_path / "log", "--fleet", acme())
    assert (code, f"line 2: {why}" in said or why in said) == (1, True)


def test_a_log_that_goes_on_as_another_nodes_is_named(tmp_path: Path) -> None:
    """Who has a key of the fleet and can write the file could else append what its owner never wrote, and sign it."""
    path = written(tmp_path / "log")
    file = AuditFile(path, "fog1")
    file.open(AT_S)
    file.add(AT_S, "file", {"node": "drone2", "before": "0" * 64})
    file.add(AT_S, "command", {"who": "gs-g", "seq": 99})
    file.sign(AT_S, seal("drone2"))
    file.sync(AT_S)
    says(path, 1, f"{path}: line 26: of drone2; expected fog1, whose log it is")


def test_a_log_behind_a_symbolic_link_stays_on_its_disk_when_it_is_rotated(tmp_path: Path) -> None:
    disk, link = tmp_path / "disk", tmp_path / "log"
    disk.mkdir()
    link.symlink_to("disk/log")
    written(link, largest=1000)
    assert sorted(each.name for each in tmp_path.iterdir()) == ["disk", "log"]
    assert link.is_symlink()
    assert len(list(disk.iterdir())) > 2
    assert verify(link, "--fleet", acme())[0] == 0
    assert verify(link)[1].replace(str(link), "") == verify(disk / "log")[1].replace(str(disk / "log"), "")


@pytest.mark.parametrize("sign1", ["", "!", "AAAA", None, 7])
def test_a_signature_that_is_none_is_named(tmp_path: Path, sign1: Any) -> None:
    file = AuditFile(tmp_path / "log", "fog1")
    file.open(AT_S)
    file.add(AT_S, "head", {"sign1": sign1})
    file.sync(AT_S)
    says(tmp_path / "log", 1, "line 2: its signature cannot be read")


def test_lines_that_a_killed_session_had_not_signed_are_counted(tmp_path: Path) -> None:
    """Who adds lines behind the last signature while the node is stopped has them signed at its next start."""
    path = written(tmp_path / "log", count=8)
    log = AuditLog(path, "fog1", identity())
    log.start(5)
    log.close()
    says(path, 0, "3 lines of sessions that ended without a signature")


@pytest.mark.parametrize("content", [b"", b"text\n", b"\0\0\0", b'{"n":1}\n', b"[" * 9000 + b"\n", bytes(1_100_000)])
def test_what_is_no_audit_log_is_one_line_with_exit_code_2(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "log"
    path.write_bytes(content)
    code, said = verify(path)
    assert (code, "expected an audit log" in said) == (2, True)


def test_a_file_that_is_not_there_is_one_line_with_exit_code_2(tmp_path: Path) -> None:
    assert verify(tmp_path / "log")[0] == 2
    assert verify(tmp_path)[0] == 2


def test_a_name_with_more_digits_than_a_line_has_is_one_line(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["audit", "verify", str(tmp_path / f"a.{'9' * 5000}")])
    assert done.exit_code == 2
    assert done.output.endswith(": File name too long; expected an audit log\n")


def test_several_logs_are_verified_by_themselves(tmp_path: Path) -> None:
    first, second = written(tmp_path / "a"), written(tmp_path / "b", node="drone1")
    second.write_bytes(second.read_bytes().replace(b"gs-g", b"gs-x", 1))
    done = CliRunner().invoke(app, ["audit", "verify", str(first), str(second), "--fleet", str(acme())])
    assert done.exit_code == 1
    assert len(done.output.splitlines()) == 2
    assert f"{second}: line 2" in done.output


# Many files are one chain.


@pytest.mark.long
def test_files_are_rotated_bounded_and_one_chain(tmp_path: Path) -> None:
    path = written(tmp_path / "log", largest=2000, count=203)
    files = sorted(tmp_path.iterdir())
    assert len(files) == 8
    assert all(file.stat().st_size < 4000 for file in files)
    code, said = verify(path, "--fleet", acme())
    assert (code, "what was before line number" in said) == (0, True)
    assert verify(*files, "--fleet", acme()) == (code, said)  # as a shell has it, by an asterisk


@pytest.mark.long
def test_a_file_that_is_missing_between_is_named(tmp_path: Path) -> None:
    path = written(tmp_path / "log", largest=2000, count=200)
    files = sorted(tmp_path.glob("log.*"))
    files[3].unlink()
    says(path, 1, f"{files[4]}: line 1: not what follows {files[2]}")


@pytest.mark.long
def test_a_crash_between_two_files_breaks_nothing(tmp_path: Path) -> None:
    path = written(tmp_path / "log", largest=2000, count=200)
    for made in (b"", b'{"n":9'):
        last = max(tmp_path.glob("log.*"))
        path.write_bytes(made)
        written(path, count=3)
        assert verify(path, "--fleet", acme())[0] == 0
        assert max(tmp_path.glob("log.*")) == last


# Power losses.


def test_a_last_line_without_its_end_is_cut_off_and_that_is_written(tmp_path: Path) -> None:
    whole = written(tmp_path / "whole", count=3).read_bytes()
    lines = whole.count(b"\n")
    first = whole.rindex(b"\n", 0, -1) + 2
    for length in (*range(first, len(whole), 40), len(whole) - 1):
        path = tmp_path / f"torn-{length}"
        path.write_bytes(whole[:length])
        code, said = verify(path)
        assert (code, "the last line has no end" in said) == (0, True)
        written(path, count=1, signed=False)
        found = [json.loads(line) for line in path.read_bytes().splitlines()]
        assert [fields["n"] for fields in found] == list(range(1, lines + 2))
        assert found[-2]["event"] == "repaired"
        assert verify(path)[0] == 0


def test_a_last_line_that_is_destroyed_stays_and_is_named(tmp_path: Path) -> None:
    path = written(tmp_path / "log", count=3)
    path.write_bytes(path.read_bytes() + b"\0" * 50 + b"\n")
    written(path, count=3)
    says(path, 1, "line 5: it cannot be read")


def test_a_first_line_that_is_destroyed_stays_and_is_named(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = written(tmp_path / "log", count=3)
    whole = path.read_bytes()
    spoilt = b"\xff" * 50 + whole[50:]
    path.write_bytes(spoilt)
    written(path, count=3)
    assert path.read_bytes().startswith(spoilt)
    assert [json.loads(line)["n"] for line in path.read_bytes().splitlines()[1:]] == list(range(2, 8))
    assert caplog.messages == [f"audit log {path}: line 1 cannot be read; it is left there, for `mqttxt audit verify`"]
    code, said = verify(path)
    assert (code, "line 1: it cannot be read" in said) == (2, True)
    rotated = written(path, largest=1, count=1)
    assert [file.suffix for file in sorted(tmp_path.iterdir())] == ["", ".000000002"]
    assert verify(rotated)[0] == 2


@pytest.mark.parametrize("older", [True, False])
@pytest.mark.parametrize("content", [b"\xff\n" * 30, b"\0\n" + bytes(100)])
def test_a_file_of_which_nothing_is_left_ends_no_role_and_the_chain_goes_on(
    tmp_path: Path, older: bool, content: bytes
) -> None:
    path = written(tmp_path / "log", largest=1 if older else 10**6, count=3)
    files = sorted(tmp_path.glob("log.*"))
    last = json.loads((files[-1] if older else path).read_bytes().splitlines()[-1])["n"] if older else 0
    path.write_bytes(content)
    written(path, count=1, signed=False)
    end = content.rindex(b"\n") + 1
    assert path.read_bytes()[:end] == content[:end]
    found = [json.loads(line) for line in path.read_bytes()[end:].splitlines()]
    assert [(fields["n"], fields["event"]) for fields in found] == [(last + 1, "file"), (last + 2, "command")]
    assert verify(path)[0] != 0
    assert files == sorted(tmp_path.glob("log.*"))


# Wrong settings.


@pytest.mark.parametrize("content", [b"text\n", b'{"gs_session": 1}\n'])
def test_a_file_that_is_no_audit_log_is_not_written_to(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "journal"
    path.write_bytes(content)
    with pytest.raises(ConfigurationError, match="line 1: it cannot be read; expected an audit log, or no file"):
        AuditLog(path, "fog1")
    assert path.read_bytes() == content


def test_the_log_of_another_node_is_not_written_to(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="of drone1; expected that of fog1"):
        AuditLog(written(tmp_path / "log", node="drone1"), "fog1")


def test_one_log_for_each_process(tmp_path: Path) -> None:
    first = AuditLog(tmp_path / "log", "fog1")
    with pytest.raises(ConfigurationError, match="another process has it"):
        AuditLog(tmp_path / "log", "fog1")
    first.start(1)
    first.close()
    AuditLog(tmp_path / "log", "fog1")


def test_a_path_that_cannot_be_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path, tmp_path / "file" / "log", tmp_path / "pipe", Path("/dev/null")):
        with pytest.raises(ConfigurationError, match="cannot be written: "):
            AuditLog(path, "fog1")
    with pytest.raises(ConfigurationError, match=r"expected no \.NUMBER at its end"):
        AuditLog(tmp_path / "log.1", "fog1")


@pytest.mark.parametrize("at_s", [0.0, 1e12])
def test_a_clock_may_be_anywhere(tmp_path: Path, at_s: float) -> None:
    file = AuditFile(tmp_path / "log", "fog1")
    file.open(at_s)
    file.sync(at_s)
    assert verify(tmp_path / "log")[0] == 0


def test_a_log_without_an_identity_says_that_it_is_not_signed(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    log = AuditLog(tmp_path / "log", "fog1")
    assert "not signed without `identity`" in caplog.text
    log.start(7)
    log.record(Audit("command", command_payload(Arm()), 5001, "gs-g", 1, True))
    log.close()
    start, command, _ = [json.loads(line) for line in (tmp_path / "log").read_bytes().splitlines()[1:]]
    assert (start["session"], start["signed"]) == (7, False)
    assert (command["ms"], command["who"], command["signed"], command["drone"]) == (5001, "gs-g", True, 1)
    assert [command["said"][name] for name in ("gs_session", "seq", "command")] == [GS_SESSION, 1, "arm"]
