"""How each kind of autopilot speaks the log protocol, beyond what its recording tells."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from sitl.ardupilot.logs import CopterLogLink
from sitl.logs import AT_ONCE, DATA_BYTES, Log, LogLink, Logs
from sitl.px4.logs import Px4LogLink

BOTH = [Px4LogLink, CopterLogLink]
DATA = bytes(range(256)) * 20


class Side:
    """One link of an autopilot with one log."""

    def __init__(self, cls: type[LogLink]) -> None:
        self.logs = Logs([Log(5, DATA)])
        self.armed = False
        self.texts: list[str] = []
        self.link = cls(self)

    def say(self, text: str) -> None:
        self.texts.append(text)

    def list(self) -> list[Any]:
        self.link.answer(mavlink.MAVLink_log_request_list_message(1, 1, 0, 0xFFFF))
        return self.link.due()

    def ask(self, offset: int, count: int) -> None:
        self.link.answer(mavlink.MAVLink_log_request_data_message(1, 1, self.link.first, offset, count))

    def all(self) -> bytes:
        """What is sent up to the end."""
        out = b""
        while sent := self.link.due():
            assert len(sent) <= AT_ONCE
            assert all(
                one.ofs == offset for one, offset in zip(sent, range(sent[0].ofs, 10**6, DATA_BYTES), strict=False)
            )
            out += b"".join(bytes(one.data[: one.count]) for one in sent)
        return out


@pytest.mark.parametrize("cls", BOTH)
def test_all_of_a_log_comes_some_at_a_time(cls: type[LogLink]) -> None:
    side = Side(cls)
    (entry,) = side.list()
    assert (entry.id, entry.num_logs, entry.last_log_num, entry.size) == (cls.first, 1, cls.first, len(DATA))
    side.ask(0, 0xFFFFFFFF)
    assert side.all() == DATA


@pytest.mark.parametrize("cls", BOTH)
def test_without_logs_there_is_one_entry_that_says_so(cls: type[LogLink]) -> None:
    side = Side(cls)
    side.link.answer(mavlink.MAVLink_log_erase_message(1, 1))
    assert [(one.num_logs, one.size) for one in side.list()] == [(0, 0)]


def test_a_px4_takes_the_newest_question_and_an_ardupilot_the_first() -> None:
    for cls, begins in ((Px4LogLink, 900), (CopterLogLink, 0)):
        side = Side(cls)
        side.list()
        side.ask(0, 4500)
        side.ask(900, 90)
        assert side.all()[:8] == DATA[begins : begins + 8]


def test_an_armed_ardupilot_says_once_that_it_does_not() -> None:
    side = Side(CopterLogLink)
    side.ask(0, 9000)
    side.armed = True
    assert (side.list(), side.list(), side.texts) == ([], [], ["Disarm for log download"])
    side.armed = False
    assert side.all() == DATA
    side.ask(0, 9000)
    side.link.answer(mavlink.MAVLink_log_request_end_message(1, 1))
    assert side.all() == b""
