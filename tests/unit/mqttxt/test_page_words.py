"""Words and events in plain English, and the page's log (docs/page.md)."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

import mqttxt
from mqttxt import (
    Armed,
    AutopilotText,
    Battery,
    Candidate,
    CommandId,
    ControlChanged,
    Event,
    Location,
    Outcome,
    PsmiList,
    QodsRanking,
    Ranked,
    Reachability,
    SensorReading,
    Severity,
    State,
    StateUpdate,
    Word,
)
from mqttxt.drone.mavlink.mav_result import _NAMES, refusal
from mqttxt.page.event_log import EventLog
from mqttxt.page.words import (
    OF_ACTIVATOR,
    REASONS,
    WORDS,
    choice_in_plain_english,
    code_of,
    headline,
    in_plain_english,
    why_left_out,
)
from tests.simulation.page_fleet import outcome

ROOT = Path(__file__).resolve().parents[3]
SPECIFIED = re.compile(
    r"\b(?:denied|expired|failed|overtaken|superseded|unconfirmed|unreachable|unsupported)\(([a-z_]+)"
)
WRITTEN = re.compile(
    r"""(?:CannotExecute\(|OtherPlan\(|refuse\(entry, |Word\.[A-Z]+, |return (?="[a-z]+_))f?"([a-z_]+)[",:]"""
)
OF_TRANSFERS = {"other_log_wanted"}
"""Why an object is not given: no word about a command."""
NO_REASONS = {"by", "is", "reason"}
"""`superseded(by ID)`, `failed(is VALUE)`, and the place of any reason."""


def update(state: State, drone: int = 1) -> StateUpdate:
    return StateUpdate(1, drone, state, 1, 10)


def test_every_word_is_explained() -> None:
    assert set(WORDS) == set(Word)


def test_every_reason_of_the_specification_is_explained() -> None:
    reasons = set(SPECIFIED.findall((ROOT / "docs" / "protocol.md").read_text(encoding="utf-8")))
    assert len(reasons) > 40
    assert reasons - NO_REASONS - set(REASONS) == set()


@pytest.mark.parametrize("node", ["activator", "drone"])
def test_every_reason_that_a_node_gives_is_explained(node: str) -> None:
    folder = Path(mqttxt.__file__).parent / node
    reasons = {reason for path in folder.rglob("*.py") for reason in WRITTEN.findall(path.read_text(encoding="utf-8"))}
    assert len(reasons) > 5
    assert reasons - OF_TRANSFERS - set(REASONS) == set()


@pytest.mark.parametrize("result", sorted(set(_NAMES) - {0, 5}))
def test_every_result_of_an_autopilot_is_explained(result: int) -> None:
    word, reason = refusal(result)
    assert word is Word.UNSUPPORTED or reason in REASONS


@pytest.mark.parametrize(
    ("said", "says"),
    [
        (
            outcome(Word.DENIED, reason="not_in_control, gs-x\x1b"),
            "It was not started. Another ground station controls the drone: gs-x\\x1b.",
        ),
        (outcome(Word.FAILED, reason="no_ack: twice"), "The autopilot did not answer. (twice)"),
        (outcome(Word.SUPERSEDED, superseded_by=CommandId(7, 2)), "A later command took its place."),
        (outcome(Word.DENIED, reason="not_in_control"), "Refused. It was not started. This station does not control"),
        (outcome(Word.FAILED, reason="autopilot: Arming denied\x1b"), "refused and gave"),
        (outcome(Word.FAILED, reason="low battery\x1b[2J"), "Reason: low battery\\x1b[2J"),
        (outcome(Word.COMPLETED, observed=False), "nothing shows the effect"),
        (outcome(Word.DENIED, reason="unknown_state"), "A MAVLink message is named mavlink/NAME."),
        (outcome(Word.UNCONFIRMED), "Nobody knows: it may have happened, and may still happen."),
        (outcome(Word.COMPLETED, settled=True), "The truth, known afterwards. Done"),
    ],
)
def test_an_outcome_in_plain_english(said: object, says: str) -> None:
    assert says in in_plain_english(said)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("said", "shown", "code"),
    [
        (
            outcome(Word.SUPERSEDED, superseded_by=CommandId(7, 2)),
            "drone 1: takeoff superseded",
            "drone 1: takeoff superseded(by 00000007:2)",
        ),
        (
            outcome(Word.DENIED, reason="on_ground", fleet="acme"),
            "drone acme/1: takeoff denied",
            "drone acme/1: takeoff denied(on_ground)",
        ),
        (
            outcome(Word.IN_PROGRESS, percent=40),
            "drone 1: takeoff in progress 40 %",
            "drone 1: takeoff in_progress 40 %",
        ),
    ],
)
def test_the_codes_of_the_specification_are_beside_what_is_shown(said: Outcome, shown: str, code: str) -> None:
    assert (headline(said), code_of(said)) == (shown, code)


@pytest.mark.parametrize(
    ("reason", "shown"),
    [
        ("on_ground", "on the ground"),
        ("not_in_control, gs-x", "controlled by gs-x"),
        ("not_in_control", "this station does not control it"),
        ("unknown(max_groundspeed)", "max groundspeed not known"),
        ("stale(battery)", "battery too old"),
        ("busy: the drone is reserved for another choice", "busy with another choice"),
        ("\x1b[2J", "\\x1b[2J"),
    ],
)
def test_why_a_drone_was_left_out_of_a_choice(reason: str, shown: str) -> None:
    assert why_left_out(Candidate(drone=1, reason=reason)) == shown


def test_a_choice_in_plain_english() -> None:
    listed = Candidate(drone=2, distance_m=106.6, arrival_s=10.66), Candidate(drone=4)
    found = PsmiList(1, CommandId(7, 1), listed, (Candidate(drone=1, reason="on_ground"),), 2, fleet="acme")
    text, plain = choice_in_plain_english(found)
    assert text == "choice of fog acme/1: drone acme/2"
    assert plain == "Soonest first: drone 2 (107 m, 10.7 s), drone 4. Left out: drone 1 (on the ground)."
    assert entries(found) == [f"{text}. {plain}"]
    assert choice_in_plain_english(PsmiList(1, CommandId(7, 1), (), (), None)) == ("choice of fog 1: nobody", "")


@pytest.mark.parametrize(
    ("signer", "word", "says"),
    [
        ("fog1", Word.DENIED, True),
        ("drone1", Word.DENIED, False),
        (None, Word.DENIED, False),
        ("fog1", Word.UNCONFIRMED, True),
        ("fog1", Word.ACCEPTED, False),
    ],
)
def test_a_last_word_that_the_drone_has_not_signed_says_so(signer: str | None, word: Word, says: bool) -> None:
    """On the page, and in the line of `mqttxt gs send`."""
    said = outcome(word, signer=signer)
    assert (OF_ACTIVATOR in in_plain_english(said)) is says
    assert str(said).endswith("by the word of fog1 alone") is says


def entries(*events: Event) -> list[str]:
    log = EventLog()
    for event in events:
        log.on_event(event)
    return [json.loads(line)["text"] for line in log.lines()]


def test_a_state_is_entered_when_it_is_of_note_and_changes() -> None:
    armed, text = Armed(True), AutopilotText(Severity.WARNING, "Low\nbattery")
    found = entries(*map(update, (armed, armed, Battery(50), Armed(False), text, text)))
    said = "drone 1: autopilot, warning: Low\\nbattery"
    assert found == ["drone 1: armed", "drone 1: disarmed", said, said]


def test_a_ranking_is_entered_when_its_order_changes() -> None:
    def ranking(*drones: int, age_s: float = 0) -> QodsRanking:
        ranked = (Ranked(drone=d, remaining_pct=50, max_groundspeed_m_s=5.0, age_s=age_s) for d in drones)
        return QodsRanking(1, tuple(ranked))

    found = entries(ranking(1, 2), ranking(1, 2, age_s=3), ranking(2, 1))
    assert found == ["fog 1: QoDS ranking [1, 2]", "fog 1: QoDS ranking [2, 1]"]


def test_every_event_is_exported_where_all_are_asked_for() -> None:
    log = EventLog(kept=1)
    for event in map(update, (Armed(True), Location(47.0, 8.0, 498.0, 10.0), Battery(50), Armed(True), Armed(False))):
        log.on_event(event)
    assert [json.loads(line)["text"] for line in log.lines()] == ["drone 1: disarmed"]
    found = [json.loads(line) for line in log.lines(of_all=True)]
    assert [entry["text"] for entry in found] == [
        "drone 1: armed",
        "drone 1: location: latitude_deg 47.0, longitude_deg 8.0, altitude_amsl_m 498.0, altitude_m 10.0",
        "drone 1: battery: remaining_pct 50",
        "drone 1: armed",
        "drone 1: disarmed",
    ]
    assert found[1]["event"]["state"]["latitude_deg"] == 47.0
    (line,) = log.lines("Remaining_PCT 50", of_all=True)
    assert line in log.lines(of_all=True)


def test_who_is_there_and_who_controls() -> None:
    assert entries(
        Reachability(1, 2, False),
        ControlChanged(1, 2, "gs-x", False, 3),
        ControlChanged(1, 2, "page", True, 4),
        ControlChanged(1, 2, None, False, 5),
    ) == [
        "drone 2: not reachable",
        "drone 2: controlled by gs-x",
        "drone 2: controlled by this station",
        "drone 2: controlled by nobody",
    ]


def test_the_log_is_bounded_searched_and_has_every_field() -> None:
    log = EventLog(kept=3)
    for number in range(1, 6):
        log.add("Sent", f"Arm to drone {number}")
    reading = SensorReading(1, 2, 3, 4, 5, "kelvin", 280.5, "K", 6)
    log.on_event(reading)
    assert [entry["number"] for entry in log.after(0, 10)] == [4, 5, 6]
    assert [entry["number"] for entry in log.after(4, 1)] == [6]
    assert log.after(6, 10) == []
    (line,) = log.lines("ARM TO DRONE 5")
    assert json.loads(line)["kind"] == "Sent"
    (line,) = log.lines("KELVIN")
    found = json.loads(line)
    assert found["event"]["kind"] == "kelvin"
    assert found["event"]["value"] == 280.5
