"""The journal: what was open survives a restart, and so do last words, heard or not; a cut-off line is no harm."""

from __future__ import annotations

import errno
from contextlib import closing
from pathlib import Path

import pytest

from mqttxt.core.address import BrokerAddress
from mqttxt.drone.answers import Unfinished
from mqttxt.drone.effects import Journal
from mqttxt.drone.journal import ASKED_FOR_S, GAP_NOTED_S, MOST_DELIVERED, JournalFile
from mqttxt.errors import ConfigurationError
from mqttxt.protocol.messages import CommandId, Word

OPEN, SAID, DONE = CommandId(1, 1), CommandId(1, 2), CommandId(1, 3)


def _whole(path: Path) -> JournalFile:
    """A journal in which nothing of before is missing."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch()
    return JournalFile(path)


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
    assert len(path.read_text().splitlines()) == 3


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
    first, *others = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join([first[:9] + b"\x00" + first[10:], *others]))
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
    opened, said, done = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join([opened, b"\x00" + said, done]))
    for _ in range(3):
        assert started(path).unfinished == [Unfinished(DONE, "takeoff", delivered=True)]


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
