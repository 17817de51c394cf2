"""What others wrote is shown as it is: no terminal obeys it, no markup is read in it, no line is added to a log."""

from __future__ import annotations

import io
import logging
import sys

import cbor2
import pytest
from rich.console import Console
from rich.table import Table

from mqttxt.cli import main
from mqttxt.cli.common import _Lines
from mqttxt.cli.watch import _shown
from mqttxt.core.effects import Log
from mqttxt.core.printable import printable
from mqttxt.errors import PayloadError
from mqttxt.protocol.codec import decode, encode
from mqttxt.protocol.control import Control, DroneRecord, Registration
from mqttxt.protocol.messages import CommandId, Word
from mqttxt.protocol.rankings import Candidate
from mqttxt.station.outcomes import Outcome, PsmiList, SensorReading
from mqttxt_conformance.registry import Finding, Rule, Verdict
from mqttxt_conformance.report import print_table
from tests.simulation.fogs import ActivatorBench, of
from tests.simulation.world import GS_SESSION, World

HOSTILE = "\x1b]0;owned\x07\x1b[2J\n[/nope]\u202e\x9b1m"
NAMES = ["[/nope]", "", "x" * 65, "a b", "\x1b[2J", "a/b", "#", "é"]


def is_harmless(text: str) -> bool:
    return all(character.isprintable() or character == "\n" for character in text)


def test_what_is_shown_stays_and_what_a_terminal_obeys_is_spelled_out() -> None:
    assert printable("21.5 °C, 90 %, Zürich") == "21.5 °C, 90 %, Zürich"
    assert printable(HOSTILE) == r"\x1b]0;owned\x07\x1b[2J\n[/nope]\u202e\x9b1m"


def test_outcomes_lists_and_readings_print_no_escapes() -> None:
    said = Outcome(CommandId(1, 1), 1, 1, "arm", Word.DENIED, HOSTILE)
    left_out = PsmiList(1, CommandId(1, 1), (), (Candidate(drone=1, reason=HOSTILE),), None)
    read = SensorReading(1, 1, 1, 1, 1, "gas", 1.0, HOSTILE, 0)
    for one in (said, left_out, read):
        assert is_harmless(str(one))
    assert len(str(said).splitlines()) == 1


def test_a_table_shows_markup_of_others_as_it_is() -> None:
    out = io.StringIO()
    shown = Table("control")
    shown.add_row(_shown(HOSTILE))
    Console(file=out, width=120).print(shown)
    assert "[/nope]" in out.getvalue()
    assert is_harmless(out.getvalue())


def test_a_conformance_report_shows_what_a_subject_said_as_it_is() -> None:
    out = io.StringIO()
    rule = Rule("uav", "name", ("R1",), "states it", lambda kit: None)  # type: ignore[arg-type,return-value]
    print_table("UAV client", [Finding(rule, Verdict.FAIL, HOSTILE + "\\")], Console(file=out, width=140))
    assert is_harmless(out.getvalue())
    assert "[/nope]" in out.getvalue()


def test_a_log_line_is_one_line() -> None:
    record = logging.LogRecord("mqttxt", logging.WARNING, "", 1, "topic %s", (HOSTILE,), None)
    line = _Lines("%(levelname)s %(message)s").format(record)
    assert line == "WARNING topic " + printable(HOSTILE)


def test_an_error_that_ends_a_command_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["mqttxt", "gs", "send", "arm\x1b[2J\nmqttxt: all is well"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert "\x1b" not in said
    assert len(said.splitlines()) == 1


@pytest.mark.parametrize("name", NAMES)
def test_names_that_no_topic_can_have_are_refused(name: str) -> None:
    registration = encode(Registration(name="x", session=1, nonce=1, lease_s=30))
    fields = cbor2.loads(registration)
    with pytest.raises(PayloadError, match="name: expected "):
        decode(Registration, cbor2.dumps([fields[0], name, *fields[2:]]))
    record = cbor2.loads(encode(DroneRecord(activator_session=1, up=True, drone_session=1, holder="x")))
    with pytest.raises(PayloadError, match="holder: expected "):
        decode(DroneRecord, cbor2.dumps([name if field == "x" else field for field in record]))


def test_a_station_with_such_a_name_takes_no_drone_and_reaches_no_table() -> None:
    bench = ActivatorBench()
    bench.appear()
    fields = cbor2.loads(encode(Registration(name="x", session=5, nonce=7, lease_s=30, control=Control.WANT)))
    effects = bench.cloud("init_connect", cbor2.dumps([fields[0], "[/nope]", *fields[2:]]))
    assert [type(effect) for effect in effects] == [Log]
    assert of(effects, "fog1/drone1/reachable") == []

    world = World().start(1000)
    record = cbor2.loads(encode(DroneRecord(activator_session=0x22, up=True, drone_session=0x33, holder="x")))
    forged = cbor2.dumps(["[/nope]" if field == "x" else field for field in record])
    world.run("gs", world.hears("gs", "fog1/drone1/reachable", forged))
    assert world.gs.fogs[1].drones[1].holder != "[/nope]"
    assert world.gs.session == GS_SESSION
