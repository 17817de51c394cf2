"""Everything as one run: its order, what of it is done, how it goes on, and what it says of the time left."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Any

import pytest
import yaml
from rich.console import Console
from typer.testing import CliRunner

from testbed.cli import campaign as campaign_cli
from testbed.cli.commands import app
from testbed.errors import DockerError, Interrupted, UserError
from testbed.fly import manifest, resume
from testbed.fly.campaign import run
from testbed.fly.campaign.estimate import Durations, in_words
from testbed.fly.campaign.run import fly_all
from testbed.fly.campaign.targets import Wish, plans_of
from testbed.fly.results import METRICS, Series, read_json, write_json
from testbed.fly.runner import Begun, run_series
from testbed.fly.validity import Verdict
from testbed.plan.experiments import ARMS, EXPERIMENTS, Plan
from testbed.plan.fleets import FLEET_FILE
from testbed.plan.profiles.reading import profile_names
from tests.handmade.finished import both, count_attempts, finished
from tests.handmade.made_up_fleet import HERE, Fleet, Quiet
from tests.handmade.pages import sketched_papers

SMALL = Wish(attempts="2", experiments="scenario-3", arms="thesis,direct", profiles="ideal")


pytestmark = pytest.mark.usefixtures("made_up")


Flown = list[tuple[str, str, int]]


def flying(flown: Flown, fleet: Callable[[], Fleet] = lambda: Fleet([])) -> run.Fly:
    """Flies with containers that are made up, and writes down arm, protocol and number."""

    def fly(plan: Plan, series: Series, begun: dict[int, Begun]) -> list[Verdict]:
        progress = Quiet()
        try:
            return run_series(plan, series, progress, fleet(), begun)
        finally:
            attempts = [said for said in progress.said if isinstance(said, tuple) and len(said) == 4]
            flown.extend((plan.arm.name, protocol, number) for protocol, number, _, _ in attempts)

    return fly


def campaign(
    root: Path, wish: Wish = SMALL, fly: run.Fly | None = None, report: run.Report = count_attempts
) -> tuple[Flown, bool, str]:
    """What was flown, whether everything counts, and what was said."""
    flown: Flown = []
    console = Console(file=StringIO(), width=200)
    counted = fly_all(plans_of(wish), root, console, fly or flying(flown), report)
    assert isinstance(console.file, StringIO)
    return flown, counted, console.file.getvalue()


def breaking_off(at: int) -> Callable[[], Fleet]:
    """Fleets of which one is interrupted in its mission."""
    made: list[Fleet] = []

    class Broken(Fleet):
        def execute(self, service: str, command: list[str], *, limit_s: float) -> Any:
            made.append(self)
            if len(made) == at:
                raise Interrupted("interrupted; the containers are ended")
            return super().execute(service, command, limit_s=limit_s)

    return lambda: Broken([])


@pytest.mark.long
def test_what_people_ask_first_comes_first_and_everything_comes_once() -> None:
    plans = plans_of(Wish())
    names = [(plan.experiment, plan.arm.name, plan.profile.name) for plan in plans]
    assert len(names) == len(set(names)) == len(EXPERIMENTS) * len(ARMS) * len(profile_names())
    first = names[: 2 * len(EXPERIMENTS)]
    assert {(arm, profile) for _, arm, profile in first} == {("thesis", "ideal"), ("thesis", "thesis")}
    assert {experiment for experiment, _, _ in first} == set(EXPERIMENTS)
    assert all(arm != "thesis" for _, arm, _ in names[-20:])
    assert all(plan.factors == plan.arm.factors for plan in plans)


@pytest.mark.parametrize(
    ("wish", "said"),
    [
        (
            Wish(experiments="scenario-1,scenario-9"),
            "EXPERIMENTS=scenario-1,scenario-9: 'scenario-9': expected a list of",
        ),
        (Wish(arms="best"), "ARMS=best: 'best': expected a list of thesis, thesis-concurrent"),
        (Wish(profiles="ideal,"), "PROFILES=ideal,: '': expected a list of ideal, 3g"),
        (Wish(attempts="0"), "ATTEMPTS=0: expected a whole number from 1 to 99"),
        (Wish(count="many"), "COUNT=many: expected a whole number"),
    ],
)
def test_a_wrong_list_is_said_in_one_line(wish: Wish, said: str) -> None:
    with pytest.raises(UserError, match=re.escape(said)):
        plans_of(wish)


def test_everything_is_flown_and_a_second_run_finds_it_done(tmp_path: Path) -> None:
    flown, counted, said = campaign(tmp_path)
    assert counted
    assert flown == [
        (arm, protocol, number)
        for arm in ("thesis", "direct")
        for protocol, number in (("mqttxt", 1), ("mavlink", 1), ("mavlink", 2), ("mqttxt", 2))
    ]
    assert said.startswith("2 series (1 experiment, 2 arms, 1 profile), 2 attempts over each protocol: 0 done; about")
    assert "series 2 of 2, less than a minute left: scenario 3, arm direct, profile ideal" in said
    again, counted, said = campaign(tmp_path)
    assert (again, counted) == ([], True)
    assert said == "2 series (1 experiment, 2 arms, 1 profile), 2 attempts over each protocol: 2 done\n"


def test_a_broken_off_run_goes_on_where_it_stopped(tmp_path: Path) -> None:
    flown: Flown = []
    with pytest.raises(Interrupted):
        campaign(tmp_path, fly=flying(flown, breaking_off(at=3)))
    assert flown == [("thesis", "mqttxt", 1), ("thesis", "mavlink", 1), ("thesis", "mavlink", 2)]
    flown, counted, said = campaign(tmp_path)
    assert counted
    assert flown[:3] == [("thesis", "mavlink", 2), ("thesis", "mqttxt", 2), ("direct", "mqttxt", 1)]
    assert "arm thesis, profile ideal, goes on with attempt 2" in said
    (series,) = (tmp_path / "scenario-3" / "thesis-ideal").iterdir()
    assert sorted(path.name for path in (series / "mavlink").iterdir()) == [
        "attempt-01",
        "attempt-02",
        "attempt-02-repeat-1",
    ]


def test_a_broken_off_series_of_another_revision_is_begun_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(Interrupted):
        campaign(tmp_path, fly=flying([], breaking_off(at=3)))
    for module in (manifest, resume):
        monkeypatch.setattr(module, "revision", lambda: HERE | {"commit": "decaf"})
    flown, _, said = campaign(tmp_path)
    assert len(flown) == 8
    assert "begun anew (it was flown at another revision)" in said
    assert len(list((tmp_path / "scenario-3" / "thesis-ideal").iterdir())) == 2


def test_a_finished_series_counts_whatever_its_revision(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    campaign(tmp_path)
    monkeypatch.setattr(resume, "revision", lambda: HERE | {"commit": "decaf"})
    assert campaign(tmp_path)[0] == []


def test_more_attempts_go_on_with_the_series_that_is_there(tmp_path: Path) -> None:
    campaign(tmp_path)
    flown, _, said = campaign(tmp_path, Wish(attempts="3", experiments="scenario-3", arms="direct", profiles="ideal"))
    assert flown == [("direct", "mqttxt", 3), ("direct", "mavlink", 3)]
    assert "goes on with attempt 3" in said


def test_what_was_flown_and_not_measured_is_only_measured(tmp_path: Path) -> None:
    campaign(tmp_path)
    (path,) = tmp_path.glob(f"scenario-3/direct-ideal/*/{METRICS}")
    path.unlink()
    flown, counted, said = campaign(tmp_path)
    assert (flown, counted) == ([], True)
    assert "arm direct, profile ideal, flown and not measured yet" in said
    assert path.exists()


def test_another_count_of_messages_is_flown_though_there_is_a_series(tmp_path: Path) -> None:
    few, many = (Wish(experiments="messages", arms="thesis", profiles="ideal", count=count) for count in ("2", "3"))
    campaign(tmp_path, few)
    assert campaign(tmp_path, few)[0] == []
    assert len(campaign(tmp_path, many)[0]) == 2


def test_a_number_that_stays_void_is_said_and_the_rest_goes_on(tmp_path: Path) -> None:
    flown: Flown = []
    fleets = [Fleet([], dropped=1), Fleet([])]
    _, counted, said = campaign(tmp_path, Wish("1", "scenario-3", "thesis,direct", "ideal"), flying(flown, fleets.pop))
    assert counted is False
    assert flown[:2] == [("thesis", "mqttxt", 1), ("thesis", "mavlink", 1)]
    assert flown[2:] == [("direct", "mqttxt", 1)] * 3
    assert (
        "not counted: scenario 3, arm direct, profile ideal, attempt 1: void each time, at last: captures dropped "
        "packets: gs 1" in said
    )


def test_a_series_that_cannot_be_flown_is_said_and_the_rest_goes_on(tmp_path: Path) -> None:
    flown: Flown = []
    well = flying(flown)

    def fly(plan: Plan, series: Series, begun: dict[int, Begun]) -> list[Verdict]:
        if plan.arm.name == "thesis":
            raise UserError("the mission could not be flown: --streams: none")
        return well(plan, series, begun)

    _, counted, said = campaign(tmp_path, fly=fly)
    assert counted is False
    assert {arm for arm, _, _ in flown} == {"direct"}
    assert "not counted: scenario 3, arm thesis, profile ideal: the mission could not be flown: --streams: none" in said


def test_what_is_found_void_when_it_is_measured_is_flown_again_at_once(tmp_path: Path) -> None:
    def void_at_first(path: Path) -> None:
        count_attempts(path)
        metrics = read_json(path / METRICS)
        side = metrics["protocols"]["mavlink"]
        side["void"] += [one | {"reason": "the clock was set"} for one in side["attempts"] if one["repeat"] == 0]
        side["attempts"] = [one for one in side["attempts"] if one["repeat"]]
        write_json(path / METRICS, metrics)

    flown, counted, _ = campaign(tmp_path, Wish("1", "scenario-3", "thesis", "ideal"), report=void_at_first)
    assert counted
    assert flown == [("thesis", protocol, 1) for protocol in ("mqttxt", "mavlink")] * 2


def test_the_time_left_is_that_of_attempts_flown_here(tmp_path: Path) -> None:
    (plan,) = plans_of(Wish("1", "scenario-3", "thesis", "ideal"))
    assert Durations(tmp_path).of(plan, "mqttxt") == 65.0
    campaign(tmp_path, Wish("3", "scenario-3", "direct", "ideal"))
    for path, took_s in zip(sorted(tmp_path.glob("*/*/*/mqttxt/*/manifest.json")), (100.0, 50.0, 70.0), strict=True):
        write_json(path, read_json(path) | {"took_s": took_s})
    assert Durations(tmp_path).of(plan, "mqttxt") == 70.0


def test_an_attempt_that_does_not_say_what_it_took_is_estimated_by_its_mission(tmp_path: Path) -> None:
    (plan,) = plans_of(Wish("1", "scenario-3", "thesis", "ideal"))
    campaign(tmp_path, Wish("1", "scenario-3", "thesis", "ideal"))
    (path,) = tmp_path.glob("*/*/*/mqttxt/*/manifest.json")
    write_json(path, {name: value for name, value in read_json(path).items() if name != "took_s"})
    events = (
        '{"t_ns": 0, "event": "mission_start", "scenario": "scenario-3", "drones": [1]}\n'
        '{"t_ns": 30000000000, "event": "mission_end", "status": "completed"}\n'
    )
    (path.parent / "events.jsonl").write_text(events)
    assert Durations(tmp_path).of(plan, "mqttxt") == 70.0


@pytest.mark.parametrize(
    ("seconds", "said"),
    [
        (12, "less than a minute"),
        (70, "about 1 min"),
        (3540, "about 59 min"),
        (3600, "about 1 h"),
        (9_700, "about 2 h 40 min"),
    ],
)
def test_a_time_in_words(seconds: float, said: str) -> None:
    assert in_words(seconds) == said


def test_what_to_type_to_go_on_has_what_was_asked_for() -> None:
    assert Wish().typed() == "make all"
    assert SMALL.typed() == "make all ATTEMPTS=2 EXPERIMENTS=scenario-3 ARMS=thesis,direct PROFILES=ideal"
    assert Wish(fogs="3", drones="12").typed() == "make all FOGS=3 DRONES=12"
    assert Wish(fleet="my fleet.yaml").typed() == "make all FLEET='my fleet.yaml'"


def test_a_campaign_flies_the_fleet_that_was_asked_for() -> None:
    assert {plan.fleet.flown for plan in plans_of(Wish(experiments="scenario-3", fogs="1", drones="2"))} == {"1:1,2"}


def test_a_fleet_file_that_says_something_else_by_now_is_flown_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "mine.yaml"
    monkeypatch.setenv("FLEET", str(path))
    document = yaml.safe_load(FLEET_FILE.read_text())
    wish = replace(SMALL, attempts="1", arms="thesis", fleet=str(path))
    flown_each_time = []
    for fogs in ({1: [1, 2], 2: [3]}, {1: [1, 2], 2: [3]}, {1: [1], 2: [2, 3]}):
        path.write_text(yaml.safe_dump(document | {"fogs": fogs}))
        flown_each_time.append(len(campaign(tmp_path / "results", wish)[0]))
    assert flown_each_time == [2, 0, 2]


@pytest.mark.parametrize(("raised", "code"), [(Interrupted("interrupted"), 130), (DockerError("Docker is gone"), 1)])
def test_a_run_that_is_broken_off_says_what_to_type_and_leaves_the_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, raised: Exception, code: int
) -> None:
    def broken(*_: Any, **__: Any) -> list[Verdict]:
        raise raised

    finished(tmp_path, *both())
    monkeypatch.setattr(campaign_cli, "only_run", lambda: None)
    monkeypatch.setattr(campaign_cli, "run_series", broken)
    words = ["all", "--arms", "direct", "--experiments", "scenario-3", "--profiles", "ideal", "--results"]
    with sketched_papers():
        result = CliRunner().invoke(app, [*words, str(tmp_path)])
    assert result.exit_code == code
    assert result.stderr.splitlines() == [
        f"testbed: {raised}",
        "to go on, type: make all EXPERIMENTS=scenario-3 ARMS=direct PROFILES=ideal",
    ]
    assert "scenario-1/thesis-ideal" in (tmp_path / "summary.html").read_text()
