"""Whatever a person or a disk gives: addresses, names, parameters, journals are taken or named, never a traceback."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from mqttxt.cli.common import numbers_of
from mqttxt.cli.parameters import parse_command
from mqttxt.core.address import BrokerAddress, address_of
from mqttxt.core.effects import Publish, Subscribe
from mqttxt.core.settings import Settings
from mqttxt.drone.journal import JournalFile
from mqttxt.drone.mavlink.transports import AutopilotAddress
from mqttxt.drone.role import UavClient
from mqttxt.errors import ConfigurationError
from mqttxt.protocol.commands import COMMANDS
from mqttxt.protocol.names import check_prefix, check_station_name
from mqttxt.protocol.values import Encoding
from tests.examples import examples
from tests.simulation.strategies import PLAIN


def _address_to_listen_at(text: str) -> tuple[str, int]:
    return address_of(text, option="--listen")


def _fleet_numbers(text: str) -> frozenset[int]:
    return numbers_of(text, 250, "--drones")


PARSERS: list[Callable[[str], Any]] = [
    BrokerAddress.parse,
    AutopilotAddress.parse,
    check_prefix,
    check_station_name,
    _address_to_listen_at,
    _fleet_numbers,
]
PIECES = st.sampled_from(
    [
        "mqtt://",
        "mqtts://",
        "udp:",
        "tcp:",
        "serial:",
        "/dev/ttyACM0",
        ":",
        "@",
        "[",
        "]",
        "::1",
        "host",
        "/",
        "..",
        "?a",
    ]
)
NUMBERS = st.integers().map(str) | st.sampled_from(["0", "65535", "65536", "9" * 5000, "٣", "²", "-1", "1e3", "nan"])
TEXTS = st.lists(PIECES | NUMBERS | st.text(max_size=8), max_size=7).map("".join)


def refused(parse: Callable[..., Any], *arguments: Any) -> str | None:
    """What a parser says of its arguments, None where it takes them."""
    try:
        parse(*arguments)
    except ConfigurationError as refusal:
        return str(refusal)
    return None


@pytest.mark.parametrize("parse", PARSERS, ids=lambda parse: getattr(parse, "__qualname__", str(parse)))
@examples(200)
@given(text=TEXTS)
@example(text="mqtt://a..b:1883")
@example(text="mqtt://" + "a" * 64)
@example(text="mqtt://a\0b")
@example(text="mqtt://h:0")
@example(text="serial:/dev/ttyACM0:" + "9" * 5000)
@example(text="tcp:a..b:5760")
@example(text="host:" + "9" * 5000)
@example(text="9" * 5000)
def test_a_setting_is_taken_or_named_with_what_was_expected(parse: Callable[[str], Any], text: str) -> None:
    refusal = refused(parse, text)
    assert refusal is None or ("expected" in refusal and "\n" not in refusal)


@given(st.sampled_from(["mqtt", "mqtts"]), st.text(min_size=1, max_size=30), st.integers(-1, 70_000))
def test_a_brokers_host_can_be_looked_up(scheme: str, host: str, port: int) -> None:
    """What is taken has a port that TCP knows and a name that DNS can be asked for."""
    try:
        address = BrokerAddress.parse(f"{scheme}://{host}:{port}")
    except ConfigurationError:
        return
    assert 0 < address.port < 65_536
    assert address.host.encode("idna")


@given(
    st.sampled_from([*COMMANDS, "jump", ""]), st.lists(NUMBERS | st.floats().map(str) | st.text(max_size=5), max_size=4)
)
def test_a_command_line_is_a_command_or_one_line(name: str, parameters: list[str]) -> None:
    refusal = refused(parse_command, name, parameters)
    assert refusal is None or "expected" in refusal


RECORDS = st.fixed_dictionaries(
    {
        "gs_session": st.integers() | st.sampled_from([0, 1, 2**32, "1", None, float("inf"), float("nan")]),
        "seq": st.integers(-1, 9) | st.sampled_from([2**32, 1e999]),
        "command": st.text(max_size=5) | st.just("arm"),
        "word": st.sampled_from([None, "completed", "accepted", "unconfirmed", "x", [], {}]),
        "reason": st.none() | st.text(max_size=250) | st.integers() | st.lists(st.none()),
        "done": st.booleans() | st.none(),
    }
)
LINES = RECORDS.map(json.dumps).map(str.encode) | PLAIN.map(repr).map(str.encode) | st.binary(max_size=40)


@given(lines=st.lists(LINES, max_size=6), how=st.sampled_from(Encoding))
@example(lines=[b"[" * 100_000], how=Encoding.CBOR)
@example(lines=[b'{"gs_session": ' + b"9" * 5000 + b"}"], how=Encoding.CBOR)
@example(lines=[b'{"gs_session": 1, "seq": 0, "command": "arm", "word": "completed", "done": true}'], how=Encoding.JSON)
def test_any_journal_is_read_and_what_it_says_can_be_said_again(lines: list[bytes], how: Encoding) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "journal"
        path.write_bytes(b"\n".join(lines))
        try:
            journal = JournalFile(path)
        except ConfigurationError:  # it is no journal
            assert path.read_bytes() == b"\n".join(lines)
            return
        journal.close()
        client = UavClient(1, 5, Settings(encoding=how), unfinished=journal.unfinished)
        said = [
            effect
            for subscribe in client.on_connected("fog", 0)
            if isinstance(subscribe, Subscribe)
            for effect in client.on_subscribed(subscribe, 0)
            if isinstance(effect, Publish) and "/commands_result/" in effect.topic
        ]
        assert len(said) == len([one for one in journal.unfinished if not one.delivered])
        again = JournalFile(path)
        again.close()
        assert again.unfinished == journal.unfinished
