"""The journal: what was open survives a restart, and so do last words, heard or not; a cut-off line is no harm."""

from __future__ import annotations

import errno
import os
import shutil
import socket
from contextlib import closing
from pathlib import Path

import pytest

from mqttxt.core.address import BrokerAddress
from mqttxt.core.settings import Settings
from mqttxt.drone.answers import Unfinished
from mqttxt.drone.effects import Journal
from mqttxt.drone.journal import ASKED_FOR_S, GAP_NOTED_S, MOST_DELIVERED, JournalFile
from mqttxt.drone.journal_lines import gap_line
from mqttxt.drone.mavlink.transports import AutopilotAddress
from mqttxt.drone.process import UavRunner
from mqttxt.errors import ConfigurationError
from mqttxt.protocol.messages import CommandId, Word

OPEN, SAID, DONE = CommandId(1, 1), CommandId(1, 2), CommandId(1, 3)


def make_whole(path: Path) -> Path:
    """Write a journal without records in which nothing of before is missing."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(gap_line(ASKED_FOR_S))
    return path


def _whole(path: Path) -> JournalFile:
    return JournalFile(make_whole(path))


def _fill(path: Path) -> None:
    journal = _whole(path)
    for command_id in (OPEN, SAID, DONE):
        journal.record(Journal(command_id, "takeoff"))
    for command_id in (SAID, DONE):
        journal.record(Journal(command_id, "takeoff", Word.FAILED, "timeout"))
    journal.record(Journal(DONE, "takeoff", done=True))
    journal.close()


def started(path: Path, *, with_front: bool = False) -> JournalFile:
    """A journal as a client finds it that starts, and ends at once."""
    with closing(JournalFile(path, with_front=with_front)) as journal:
        return journal


def test_open_ids_and_last_words_come_back_and_which_of_them_were_heard(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "journal"
    _fill(path)
    expected = [
        Unfinished(OPEN, "takeoff"),
        Unfinished(SAID, "takeoff", Word.FAILED, "timeout"),
        Unfinished(DONE, "takeoff", Word.FAILED, "timeout", delivered=True),
    ]
    for _ in range(2):  # the file is made small at each start, and still says the same
        assert started(path).unfinished == expected
    assert len(path.read_text().splitlines()) == 4


@pytest.mark.long
def test_only_the_newest_of_the_heard_words_are_kept(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    journal = JournalFile(path)
    journal.record(Journal(OPEN, "takeoff"))
    for seq in range(MOST_DELIVERED + 3):
        for effect in (Journal(CommandId(2, seq), "arm", Word.COMPLETED), Journal(CommandId(2, seq), "arm", done=True)):
            journal.record(effect)
    journal.close()
    assert [one.id for one in started(path).unfinished] == [
        OPEN,
        *(CommandId(2, seq) for seq in range(3, MOST_DELIVERED + 3)),
    ]


def _hear_of(journal: JournalFile, *command_ids: CommandId) -> None:
    """Start commands, and have their last words delivered."""
    for one in command_ids:
        for effect in (Journal(one, "arm"), Journal(one, "arm", Word.COMPLETED), Journal(one, "arm", done=True)):
            journal.record(effect)


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """A journal keeps two delivered words, and remembers the dropped ones of three sessions."""
    monkeypatch.setattr("mqttxt.drone.journal.MOST_DELIVERED", 2)
    monkeypatch.setattr("mqttxt.drone.journal.MOST_FORGOTTEN", 3)


@pytest.mark.usefixtures("few")
async def test_a_restarted_client_calls_nothing_expired_that_its_journal_may_have_dropped(tmp_path: Path) -> None:
    """A completed command's word died with the fog's broker, and others have pushed its record out since."""
    path = tmp_path / "journal"
    journal = _whole(path)
    _hear_of(journal, CommandId(1, 2), CommandId(1, 1), *(CommandId(2, seq) for seq in range(3)))
    journal.close()
    for _ in range(3):  # the file is written anew at each start
        with closing(JournalFile(path)) as journal:
            assert not journal.has_gap
            assert set(journal.forgotten) == {CommandId(1, 2), CommandId(2, 0)}
            nowhere, autopilot = BrokerAddress.parse("mqtt://127.0.0.1:1"), AutopilotAddress("udp", "127.0.0.1", 0)
            ledger = UavRunner(7, nowhere, autopilot, journal, Settings()).client.desk.ledger
            asked = [CommandId(1, 1), CommandId(1, 2), CommandId(1, 3), CommandId(2, 0), CommandId(3, 0)]
            assert [ledger.may_have_forgotten(one) for one in asked] == [True, True, False, True, False]


@pytest.mark.usefixtures("few")
def test_dropped_words_of_more_sessions_than_are_remembered_are_a_gap_that_ages(tmp_path: Path) -> None:
    now_s = 0.0

    def clock_s() -> float:
        return now_s

    path = make_whole(tmp_path / "journal")
    journal = JournalFile(path, clock_s)
    now_s += 2 * ASKED_FOR_S
    _hear_of(journal, *(CommandId(session, 1) for session in range(1, 6)))
    assert not started(Path(shutil.copy(path, tmp_path / "one less"))).has_gap
    _hear_of(journal, CommandId(6, 1))
    assert journal.has_gap
    assert set(journal.forgotten) == {CommandId(session, 1) for session in (2, 3, 4)}
    copy = Path(shutil.copy(path, tmp_path / "as a crash leaves it"))
    for _ in range(2):  # the second time as a start has written it anew
        again = started(copy)
        assert (again.has_gap, again.forgotten) == (True, journal.forgotten)
    now_s += ASKED_FOR_S
    journal.record(Journal(CommandId(6, 2), "arm"))
    journal.close()
    assert not started(path).has_gap


@pytest.mark.parametrize("line", ['{"forgotten": [1]}', '{"forgotten": [1, -1]}', '{"forgotten": 7}'])
def test_a_dropped_id_that_cannot_be_read_is_a_gap(tmp_path: Path, line: str) -> None:
    path = make_whole(tmp_path / "journal")
    path.write_text(path.read_text() + f"{line}\n{{}}\n")
    assert started(path).has_gap


@pytest.mark.parametrize("cut", [1, 5, 60])
def test_a_line_that_a_power_loss_cut_off_costs_only_itself(tmp_path: Path, cut: int) -> None:
    path = tmp_path / "journal"
    _fill(path)
    path.write_bytes(path.read_bytes()[:-cut] + b"\xff")
    journal = started(path)
    assert Unfinished(OPEN, "takeoff") in journal.unfinished
    assert [left.id for left in journal.unfinished] == [OPEN, SAID, DONE]
    assert not journal.has_gap


def test_a_line_that_cannot_be_read_in_the_middle_may_have_been_any_id(tmp_path: Path) -> None:
    """Of an id that is not found nobody can say any more that it was not started."""
    path = tmp_path / "journal"
    _fill(path)
    gap, first, *others = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join([gap, first[:9] + b"\x00" + first[10:], *others]))
    for _ in range(3):  # the file is written anew at each start, and nobody knows more then
        journal = started(path)
        assert [left.id for left in journal.unfinished] == [SAID, DONE]
        assert journal.has_gap


def test_a_journal_that_the_disk_did_not_give_is_not_whole_once_it_was_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "journal"
    _fill(path)
    with monkeypatch.context() as patch:
        patch.setattr(Path, "read_text", _fail)
        journal = JournalFile(path)
    journal.record(Journal(CommandId(2, 1), "land"))
    journal.close()
    journal = started(path)
    assert [left.id for left in journal.unfinished] == [CommandId(2, 1)]
    assert journal.has_gap


def test_a_removed_journal_knows_of_no_id_of_before_until_nobody_can_ask_for_one(tmp_path: Path) -> None:
    """The second client on it knows no more than the first: an `expired` would be a false no."""
    path = tmp_path / "journal"
    _fill(path)
    path.unlink()
    now_s = 0.0

    def clock_s() -> float:
        return now_s

    for seq in range(3):
        journal = JournalFile(path, clock_s)
        assert journal.has_gap
        now_s += ASKED_FOR_S / 3 - 1
        journal.record(Journal(CommandId(2, seq), "land"))
        journal.close()
        now_s += 1_000_000  # while none runs nothing is counted: there may be no clock that did
    journal = JournalFile(path, clock_s)
    assert journal.has_gap
    for _ in range(5):
        now_s += GAP_NOTED_S
        journal.record(Journal(CommandId(2, 9), "land"))
    assert journal.has_gap
    journal.close()
    path.write_bytes(path.read_bytes() + b'{"gap_s": 1')
    journal = started(path)
    assert not journal.has_gap
    assert [left.id.seq for left in journal.unfinished] == [0, 1, 2, 9]


@pytest.mark.parametrize("age", ["-1", "1e400", "NaN", "true", '"1"', "9.5"])
def test_a_gap_without_an_age_begins_now(tmp_path: Path, age: str) -> None:
    path = tmp_path / "journal"
    path.write_text(f'{{"gap_s": {age}}}\n')
    assert started(path).has_gap
    assert path.read_text() == '{"gap_s": 0}\n'


def _fail(*_: object, **__: object) -> str:
    raise OSError(errno.EIO, "lost")


def test_an_id_whose_last_word_cannot_be_read_stays_known_over_restarts(tmp_path: Path) -> None:
    """It was started: that it is not in the journal would be answered as `expired`, which says the contrary."""
    path = tmp_path / "journal"
    journal = _whole(path)
    journal.record(Journal(DONE, "takeoff"))
    journal.record(Journal(DONE, "takeoff", Word.FAILED))
    journal.record(Journal(DONE, "takeoff", done=True))
    journal.close()
    first, opened, said, done = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join([first, opened, b"\x00" + said, done]))
    for _ in range(3):
        assert started(path).unfinished == [Unfinished(DONE, "takeoff", delivered=True)]


RECORD = b'{"gs_session": 1, "seq": 1, "command": "arm", "word": null, "reason": null, "done": false}\n'


@pytest.mark.parametrize("left", [b"", b"\x00" * 300, RECORD[:40], b"{", RECORD[:40] + b"\xff\n" + RECORD[:30]])
def test_a_journal_that_lost_its_records_may_have_had_any_id(tmp_path: Path, left: bytes) -> None:
    """As after a power loss: a client writes no journal without a whole line."""
    path = tmp_path / "journal"
    path.write_bytes(left)
    for _ in range(3):
        journal = started(path)
        assert (journal.unfinished, journal.has_gap) == ([], True)


def test_a_journal_is_never_empty_even_without_records(tmp_path: Path) -> None:
    path = make_whole(tmp_path / "journal")
    for with_front in (False, True, False):
        assert not started(path, with_front=with_front).has_gap
        assert path.read_bytes() == gap_line(ASKED_FOR_S)


@pytest.mark.parametrize("cut", [0, 1, 30])
def test_the_journal_of_an_earlier_version_is_whole_without_a_gaps_age(tmp_path: Path, cut: int) -> None:
    path = tmp_path / "journal"
    path.write_bytes(RECORD + RECORD.replace(b'"seq": 1', b'"seq": 2')[: -cut or None])
    journal = started(path)
    assert not journal.has_gap
    assert [left.id.seq for left in journal.unfinished] == ([1, 2] if cut < 2 else [1])


@pytest.mark.parametrize(
    "foreign",
    [
        b"milk\nbread\n",
        b"milk",
        b'{"fileType": "Plan"}',
        b"\n",
        b"\xff\xd8\xff\xe0\x00\x10JFIF\n",
        b"\x00{}",
        b"[1]\n5\n",
    ],
)
def test_a_file_that_is_no_journal_is_left_as_it_is(tmp_path: Path, foreign: bytes) -> None:
    path = tmp_path / "notes"
    path.write_bytes(foreign)
    with pytest.raises(
        ConfigurationError, match=r"^--journal .*notes: no line of a journal in it; expected a journal, or"
    ):
        JournalFile(path)
    assert path.read_bytes() == foreign
    assert [each.name for each in tmp_path.iterdir()] == ["notes"]


def test_what_is_no_regular_file_is_not_replaced(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "to_pipe").symlink_to("pipe")
    with socket.socket(socket.AF_UNIX) as there:
        there.bind(str(tmp_path / "socket"))
    (tmp_path / "loop").symlink_to("loop")
    for name, why in (
        ("pipe", "not a regular file"),
        ("to_pipe", "not a regular file"),
        ("socket", "not a regular file"),
        ("loop", "Too many levels of symbolic links"),
        ("x" * 256, "File name too long"),
    ):
        with pytest.raises(ConfigurationError) as refused:
            JournalFile(tmp_path / name)
        assert str(refused.value) == f"--journal {tmp_path / name}: cannot be written: {why}; expected a file"
    assert sorted(each.name for each in tmp_path.iterdir()) == ["loop", "pipe", "socket", "to_pipe"]
    assert (tmp_path / "pipe").is_fifo()
    assert (tmp_path / "socket").is_socket()


@pytest.mark.parametrize("is_there", [True, False])
def test_a_symbolic_link_stays_one_and_the_journal_is_where_it_leads(tmp_path: Path, is_there: bool) -> None:
    disk, link = tmp_path / "disk", tmp_path / "journal"
    if is_there:
        _fill(disk / "journal")
    link.symlink_to("disk/journal")
    journal = JournalFile(link)
    assert len(journal.unfinished) == (3 if is_there else 0)
    with pytest.raises(ConfigurationError, match="another process has it"):
        JournalFile(disk / "journal")
    journal.record(Journal(CommandId(2, 1), "land"))
    journal.close()
    assert link.is_symlink()
    assert Unfinished(CommandId(2, 1), "land") in started(disk / "journal").unfinished


def test_a_journal_that_another_process_has_is_left_alone(tmp_path: Path) -> None:
    """As of a client that is started twice: the first one would write on into a file that is no longer there."""
    path = tmp_path / "drone.1"
    first = JournalFile(path)
    first.record(Journal(OPEN, "takeoff"))
    with pytest.raises(ConfigurationError, match=r"journal .*drone\.1: another process has it"):
        JournalFile(path)
    JournalFile(tmp_path / "drone.2").close()
    first.record(Journal(SAID, "takeoff"))
    first.close()
    assert [left.id for left in started(path).unfinished] == [OPEN, SAID]


def test_a_journal_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ConfigurationError, match=r"journal .*file/journal: cannot be written"):
        JournalFile(tmp_path / "file" / "journal")


@pytest.mark.parametrize(
    ("url", "address"),
    [
        ("mqtt://host", BrokerAddress("host", 1883)),
        ("mqtts://host", BrokerAddress("host", 8883, tls=True)),
        ("mqtt://me:p%40ss@10.0.0.1:99", BrokerAddress("10.0.0.1", 99, username="me", password="p@ss")),
    ],
)
def test_broker_addresses(url: str, address: BrokerAddress) -> None:
    assert BrokerAddress.parse(url) == address
    assert "p@ss" not in str(address)


@pytest.mark.parametrize(
    "url",
    [
        *("host", "http://host", "mqtt://", "mqtt://host:x", "mqtt://host:99999", "mqtt://h/topic"),
        *("mqtt://10.0.0.1\n2", "mqtt://h\tost", "mqtt:\r//host", " mqtt://host", "mqtt://h ost"),
    ],
)
def test_what_is_no_brokers_address_is_named(url: str) -> None:
    with pytest.raises(ConfigurationError, match="expected mqtt://HOST"):
        BrokerAddress.parse(url, "--broker")


@pytest.mark.parametrize("url", ["{}@host:99999", "{}@host/topic", "{}@", "{}@ho st", "{}@a@host:x", "{}#/?@host"])
def test_what_is_said_of_a_wrong_address_does_not_name_its_password(url: str) -> None:
    with pytest.raises(ConfigurationError, match=r"mqtt://me:\*\*\*@.*expected mqtt://HOST") as refused:
        BrokerAddress.parse("mqtt://" + url.format("me:s3cret"))
    assert "s3cret" not in str(refused.value)
