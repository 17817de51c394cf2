"""The message set on a drone that is made up: every call from its starting state, and what fails is counted."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from io import StringIO
from pathlib import Path
from typing import Any

import pytest

from mission import message_set
from mission.events import EventLog
from mission.fleet import CommandResult, MissionError, StateValue
from mission.message_set import COMMANDS, STATES, MessageSet

GROUND, READY, HOVER = (False, 0.0), (True, 0.0), (True, 10.0)
STARTS = {"arm": GROUND, "takeoff": READY, "land": HOVER, "offboard": HOVER, "goto": HOVER}


class Drone:
    """A fleet of one and its side channel. `answers` are the words of each command's calls, accepted otherwise."""

    drones = (1,)

    def __init__(self, answers: dict[str, list[str]], silent: tuple[str, ...], refused: tuple[str, ...]) -> None:
        self.tells_faster = False
        self.repeats = False
        self.did: list[Any] = []
        self.follows = self._follows
        self._answers = answers
        self._silent = silent
        self._refused = refused
        self._start = GROUND
        self._is_open = False

    async def set(self, **wanted: Any) -> dict[str, Any]:
        self._start = (wanted["armed"], wanted.get("altitude_m", 0.0))
        return {}

    async def settle(self) -> bool:
        assert self._start[0] is False, "a call is ended by disarming"
        if self.repeats and self._is_open:
            self._start = HOVER  # what a late copy of the call did
        self._is_open = False
        return True

    def _follows(self, armed: bool) -> bool:
        return armed == self._start[0]

    async def changed(self) -> None:
        await asyncio.sleep(0)

    async def call(self, call: int, name: str) -> CommandResult:
        assert not self._is_open, "the last call has not ended"
        self._is_open = True
        self.did.append((name, self._start))
        words = self._answers.get(name, [])
        return CommandResult(1, words.pop(0) if words else "accepted")

    async def stop_fixed_rates(self) -> None:
        self.did.append("stop_fixed_rates")

    async def request_state(self, name: str) -> asyncio.Queue[StateValue]:
        self.did.append(("request_state", name))
        if name in self._refused:
            raise MissionError(f"stream {name}: denied (unknown_state)")
        values: asyncio.Queue[StateValue] = asyncio.Queue()
        values.put_nowait(StateValue({name: "of before"}, 0))
        if name not in self._silent:
            values.get_nowait()
            asyncio.get_running_loop().call_soon(
                lambda: [values.put_nowait(StateValue({name: n}, 10 * n)) for n in range(5)]
            )
        return values

    async def stop_state(self, name: str) -> None:
        self.did.append(("stop_state", name))


Fly = Callable[..., Any]


@pytest.fixture
def fly(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Fly:
    """Flies two of each kind; returns the drone, the events and what was raised."""
    monkeypatch.setattr(message_set, "TURN_S", 0.0)
    monkeypatch.setattr(message_set, "FOLLOW_LIMIT_S", 0.02)

    async def flown(
        answers: dict[str, list[str]] | None = None,
        silent: tuple[str, ...] = (),
        refused: tuple[str, ...] = (),
        change: Callable[[Drone], None] = lambda _: None,
    ) -> tuple[Drone, list[dict[str, Any]], str | None]:
        drone = Drone(answers or {}, silent, refused)
        change(drone)
        log = EventLog(tmp_path / "events.jsonl", StringIO())
        reason = None
        try:
            await MessageSet(drone, log, drone, 2).fly()  # type: ignore[arg-type]
        except MissionError as error:
            reason = str(error)
        log.close()
        return drone, [json.loads(line) for line in (tmp_path / "events.jsonl").read_text().splitlines()], reason

    return flown


def _done(events: list[dict[str, Any]]) -> dict[str, tuple[int, int]]:
    return {e["name"]: (e["received"], e["missing"]) for e in events if e["event"] == "kind_done"}


async def test_ten_kinds_come_one_after_the_other_and_each_call_from_its_starting_state(fly: Fly) -> None:
    drone, events, reason = await fly()
    assert reason is None
    assert drone.did[:11] == [*((name, STARTS[name]) for name in COMMANDS for _ in range(2)), "stop_fixed_rates"]
    assert drone.did[11:] == [(what, name) for name in STATES for what in ("request_state", "stop_state")]
    kinds = [(e["name"], e["form"], e["count"]) for e in events if e["event"] == "kind"]
    assert kinds == [*((name, "command", 2) for name in COMMANDS), *((name, "state", 2) for name in STATES)]
    assert _done(events) == dict.fromkeys([*COMMANDS, *STATES], (2, 0))
    assert [(e["call"], e["followed"]) for e in events if e["event"] == "reset"] == [(n, True) for n in range(1, 11)]
    values = [(e["name"], e["number"], e["value"]) for e in events if e["event"] == "value"]
    assert values == [(name, n, {name: n}) for name in STATES for n in (1, 2)], "a kind begins right after a value"


async def test_a_call_that_fails_is_counted_and_the_next_one_follows(fly: Fly) -> None:
    drone, events, reason = await fly({"arm": ["unconfirmed"], "goto": ["accepted", "denied"]})
    assert reason is None
    assert len([name for name, _ in drone.did[:10] if name in COMMANDS]) == 10
    assert _done(events)["arm"] == _done(events)["goto"] == (1, 1)


async def test_a_kind_of_which_nothing_succeeds_fails_the_mission_when_all_others_have_been_flown(
    fly: Fly, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(message_set, "SPARE_S", 0.1)
    _, events, reason = await fly({"land": ["denied", "unconfirmed"]}, silent=("battery",), refused=("heading",))
    assert reason == (
        "land: none of 2 (1 denied, 1 unconfirmed); battery: none of 2 (2 did not come in time); "
        "heading: none of 2 (2 stream heading: denied (unknown_state))"
    )
    done = _done(events)
    assert list(done) == [*COMMANDS, *STATES]
    assert [name for name, counts in done.items() if counts == (0, 2)] == ["land", "battery", "heading"]


async def test_what_was_told_before_a_kind_began_is_none_of_its_values(
    fly: Fly, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(message_set, "SPARE_S", 0.1)
    _, events, _ = await fly(silent=("location",))
    assert _done(events)["location"] == (0, 2)


@pytest.mark.long
async def test_a_state_that_is_told_faster_is_taken_once_in_a_turn_and_the_newest_counts(
    fly: Fly, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(message_set, "TURN_S", 0.01)
    monkeypatch.setattr(message_set, "SPARE_S", 0.1)
    _, events, _ = await fly(change=lambda drone: setattr(drone, "tells_faster", True))
    assert _done(events) == dict.fromkeys(COMMANDS, (2, 0)) | dict.fromkeys(STATES, (1, 1))
    taken = [(e["value"], e["age_ms"]) for e in events if e["event"] == "value"]
    assert taken == [({name: 4}, 40) for name in STATES]


async def test_a_late_copy_of_a_call_does_not_spoil_the_start_of_the_next_one(fly: Fly) -> None:
    drone, events, reason = await fly(change=lambda drone: setattr(drone, "repeats", True))
    assert reason is None
    assert drone.did[:10] == [(name, STARTS[name]) for name in COMMANDS for _ in range(2)]
    assert all(event["followed"] for event in events if event["event"] == "reset")


async def test_a_call_is_made_although_the_ground_station_never_hears_of_its_start(fly: Fly) -> None:
    _, events, reason = await fly(change=lambda drone: setattr(drone, "follows", lambda armed: not armed))
    assert reason is None
    followed = [e["followed"] for e in events if e["event"] == "reset"]
    assert followed == [True] * 2 + [False] * 8, "only arm begins disarmed"
