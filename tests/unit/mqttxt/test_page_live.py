"""What browsers are shown and what is sent for them, at a made-up station (docs/page.md)."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import json
import weakref
from collections.abc import AsyncIterator
from dataclasses import replace
from typing import Any, cast

import pytest

from mqttxt import (
    Arm,
    Battery,
    BrokerRefused,
    Candidate,
    CommandId,
    ConfigurationError,
    ControlChanged,
    Fog,
    GroundStation,
    Outcome,
    Plan,
    PsmiList,
    Resume,
    SensorReading,
    StartMission,
    StateUpdate,
    TransferFailed,
    Word,
)
from mqttxt.page.desk import KEPT
from mqttxt.page.history import MOST_CHARTS, MOST_POINTS, ChartKey, History
from mqttxt.page.live import Live, Viewer, now_ms
from mqttxt.station.views import CARRIED_S, UPLOAD_TTL_S
from tests.rigs.loopback import eventually
from tests.simulation.page_fleet import FakeLinks, FakeStation, outcome


class Bench:
    def __init__(self, watch_only: bool = False, links: FakeLinks | None = None) -> None:
        self.station = FakeStation()
        fogs = [self.station.the_fog]
        self.live = Live(cast("GroundStation", self.station), cast("list[Fog]", fogs), watch_only, links)
        self.viewer = self.live.enter()

    @contextlib.asynccontextmanager
    async def running(self) -> AsyncIterator[Bench]:
        task = asyncio.create_task(self.live.run())
        await asyncio.sleep(0)
        yield self
        await self.station.heard.put(None)
        for _, sent in self.station.sent:
            sent.words.put_nowait(outcome(Word.EXPIRED))
        await task

    def ask(self, command: str = "arm", **more: Any) -> dict[str, Any]:
        asked = {"number": 1, "do": "command", "command": command, "to": {"drones": [[1, 1]]}, "at_ms": now_ms()}
        return self.live.on_request(json.dumps(asked | more))


@pytest.fixture
async def bench() -> AsyncIterator[Bench]:
    async with Bench().running() as running:
        yield running


def newest(viewer: Viewer) -> dict[str, Any]:
    order: dict[str, Any] = viewer.take()["orders"][-1]
    return order


async def test_a_browser_is_sent_everything_once_and_then_what_changes(bench: Bench) -> None:
    first = bench.viewer.take()
    assert first["hello"]["station"] == "page"
    assert first["hello"]["brokers"] == ["cloud.example:8883"], "by which a browser knows that it is another fleet now"
    assert [drone["drone"] for drone in first["drones"]] == [1, 2]
    assert first["drones"][0]["states"]["battery"] == {"age_ms": 100, "remaining_pct": 90}
    assert bench.viewer.take() == {}
    bench.station.the_fog.drone(2).set(Battery(80))
    await bench.station.heard.put(StateUpdate(1, 2, Battery(80), 1, 10))
    await eventually(lambda: bench.viewer.drones, "the change is marked")
    (drone,) = bench.viewer.take()["drones"]
    assert drone["states"]["battery"]["remaining_pct"] == 80


async def test_a_browser_is_told_each_second_that_the_program_runs(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    sent_ms = bench.viewer.take()["at_ms"]
    for later_ms, sent in (
        (990, {}),
        (1010, {"at_ms": sent_ms + 1010}),
        (2000, {}),
        (2030, {"at_ms": sent_ms + 2030}),
    ):
        monkeypatch.setattr("mqttxt.page.live.now_ms", lambda later_ms=later_ms: sent_ms + later_ms)
        assert bench.viewer.take() == sent


@pytest.mark.long
async def test_a_fog_that_falls_silent_is_seen_without_an_event(bench: Bench) -> None:
    bench.viewer.take()
    bench.station.the_fog.is_live = False
    bench.station.the_fog.drone(1).is_reachable = False
    await eventually(lambda: not bench.viewer.has_fogs and bench.viewer.drones, "reviewed")
    update = bench.viewer.take()
    assert update["fogs"][0]["live"] is False
    assert update["log"][-1]["text"] == "fog 1: not heard any more"


async def test_an_event_of_a_drone_that_no_fog_lists_harms_nothing(bench: Bench) -> None:
    bench.viewer.take()
    await bench.station.heard.put(ControlChanged(1, 99, "gs-x", False, 1))
    await eventually(lambda: ("", 1, 99) in bench.viewer.drones, "marked")
    assert bench.viewer.take()["drones"] == []


async def test_a_command_is_followed_to_its_last_word_and_its_truth(bench: Bench) -> None:
    bench.viewer.take()
    number = bench.ask()["order"]
    ((drone, sent),) = bench.station.sent
    assert (drone, sent.command, sent.ttl_s) == (1, Arm(), pytest.approx(5.0, abs=0.1))
    order = newest(bench.viewer)
    assert order["open"]
    assert 4000 < order["start_left_ms"] <= 5000
    sent.words.put_nowait(outcome(Word.ACCEPTED))
    sent.words.put_nowait(outcome(Word.UNCONFIRMED))
    await eventually(lambda: not bench.live.orders()[0].waiting, "the last word")
    order = newest(bench.viewer)
    assert not order["open"]
    assert [word["word"] for word in order["words"]] == ["accepted", "unconfirmed"]
    await bench.station.heard.put(outcome(Word.COMPLETED, settled=True))
    await eventually(lambda: number in bench.viewer.orders, "the truth")
    assert newest(bench.viewer)["words"][-1]["plain"].startswith("The truth, known afterwards.")


async def test_a_command_to_several_is_sent_to_all_of_them_at_once(bench: Bench) -> None:
    bench.ask(to={"drones": [[1, 1], [1, 2]]})
    assert [drone for drone, _ in bench.station.sent] == [1, 2]
    bench.ask(to={"fogs": [1]})
    assert bench.station.sent[-1][0] is None


async def test_a_second_click_sends_no_second_drone_to_the_same_place(bench: Bench) -> None:
    """The first drone is busy (R7.4), so that the fog would choose another one, to the same place and height."""
    place = {"latitude_deg": 47.1, "longitude_deg": 8.1, "altitude_m": 20}
    chosen: dict[str, Any] = {"command": "goto", "parameters": place, "to": {"best": [1]}}
    bench.ask(**chosen)
    again = bench.ask(**chosen)
    assert again["error"].startswith("not sent: the same command has no last word yet: goto latitude 47.1")
    assert len(bench.station.sent) == 1
    bench.ask(**{**chosen, "parameters": place | {"altitude_m": 30}})
    bench.ask(**{**chosen, "to": {"drones": [[1, 2]]}})
    assert len(bench.station.sent) == 3, "another height, and a named drone"
    bench.station.sent[0][1].words.put_nowait(outcome(Word.FAILED))
    await eventually(lambda: not bench.live.orders()[0].waiting, "the first one's last word")
    assert "error" not in bench.ask(**chosen)
    assert len(bench.station.sent) == 4


async def test_what_is_refused_is_in_the_log_as_what_is_sent_is(bench: Bench) -> None:
    """The notice in the browser has room for the newest words alone."""
    bench.ask("hold", at_ms=now_ms() - 6000)
    bench.ask("hold")
    texts = [entry["text"] for entry in bench.viewer.take()["log"]]
    late = "not sent: it was asked for 6.0 s before it came to the page's program; expected less than 5 s for hold"
    assert texts == [late, "hold to drone 1"]


async def test_several_drones_are_taken_by_one_request(bench: Bench) -> None:
    bench.ask(do="take_over", to={"drones": [[1, 2], [1, 1]]})
    await eventually(lambda: bench.station.taken, "the takeover")
    assert bench.station.taken == [(1, (2, 1))], "a second request would have the epoch of before the first"
    order = newest(bench.viewer)
    assert [word["word"] for word in order["words"]] == ["completed", "completed"]
    assert not order["open"]


async def test_what_cannot_be_sent_says_so_and_nothing_waits(bench: Bench) -> None:
    bench.station.the_fog.is_live = False
    bench.ask()
    bench.ask(to={"drones": [[2, 1]]})
    bench.ask(do="take_over", to={"drones": [[2, 1]]})
    await eventually(lambda: bench.live.orders()[-1].words, "the takeover's answer")
    said = [order.words[0]["word"] for order in bench.live.orders()]
    assert said == ["not sent", "not sent", "failed"]
    assert not any(order.waiting for order in bench.live.orders())


async def test_what_is_asked_of_one_fleet_is_sent_there_alone() -> None:
    """Two fleets with the same numbers: a drone, a fog, a takeover and an event are each of one of them."""
    bench, other = Bench(), FakeStation(fleet="north")
    bench.station.the_fog.fleet = "acme"
    bench.live = Live(
        cast("GroundStation", bench.station), cast("list[Fog]", [bench.station.the_fog, other.the_fog]), False
    )
    bench.viewer = bench.live.enter()
    async with bench.running():
        first = bench.viewer.take()
        named = [(drone["fleet"], drone["fog"], drone["drone"]) for drone in first["drones"]]
        assert named == [("acme", "acme/1", 1), ("acme", "acme/1", 2), ("north", "north/1", 1), ("north", "north/1", 2)]
        bench.ask(to={"drones": [["north/1", 2]]})
        bench.ask(to={"fogs": ["north/1"]})
        assert ([drone for drone, _ in other.sent], bench.station.sent) == ([2, None], [])
        bench.ask(do="take_over", to={"drones": [["acme/1", 1], ["north/1", 1], ["north/1", 2]]})
        await eventually(lambda: other.taken and bench.station.taken, "the takeovers")
        assert (bench.station.taken, other.taken) == ([(1, (1,))], [(1, (1, 2))])
        for asked in ([[1, 1]], [["acme", 1]], [["west/1", 1]]):
            bench.ask(to={"drones": asked})
        assert (len(other.sent), bench.station.sent) == (2, [])
        bench.viewer.take()
        await bench.station.heard.put(replace(outcome(Word.COMPLETED, settled=True), fleet="north"))
        await bench.station.heard.put(ControlChanged(1, 1, "gs-x", False, 1, "north"))
        await eventually(lambda: bench.viewer.drones, "marked")
        update = bench.viewer.take()
        assert [(drone["fleet"], drone["drone"]) for drone in update["drones"]] == [("north", 1)]
        assert update["log"][-1]["text"] == "drone north/1: controlled by gs-x"
        for _, sent in other.sent:
            sent.words.put_nowait(outcome(Word.EXPIRED))


async def test_a_page_that_watches_sends_nothing_whatever_it_is_asked() -> None:
    async with Bench(watch_only=True).running() as bench:
        for asked in ({}, {"command": "land"}, {"do": "take_over"}, {"to": {"fogs": [1]}}):
            assert "only watches" in bench.ask(**asked)["error"]
        assert bench.station.sent == []
        assert bench.viewer.take()["hello"]["watch_only"]


def plan_text() -> str:
    places = [(47.1, 8.1), (47.2, 8.2)]
    items = [
        {
            **{"type": "SimpleItem", "command": 16, "frame": 3, "autoContinue": True, "doJumpId": number},
            "params": [0, 0, 0, None, *place, 20],
        }
        for number, place in enumerate(places, start=1)
    ]
    mission = {"version": 2, "items": items, "plannedHomePosition": [47, 8, 488]}
    return json.dumps({"fileType": "Plan", "version": 1, "mission": mission})


async def test_a_plan_is_uploaded_shown_and_its_mission_started_by_name(bench: Bench) -> None:
    bench.viewer.take()
    bench.ask(do="start")
    assert newest(bench.viewer)["words"][0]["text"].startswith("not sent: upload its plan first")
    assert "error" not in bench.ask(do="upload", name="two.plan", text=plan_text())
    await eventually(lambda: not bench.live.orders()[-1].waiting, "the upload")
    order = newest(bench.viewer)
    assert order["text"] == "upload two.plan (2 mission items) to drone 1"
    assert order["path"] == [(47.1, 8.1), (47.2, 8.2)]
    assert [word["word"] for word in order["words"]] == ["completed"]
    (plan,) = bench.station.the_fog.drone(1).uploaded
    bench.ask(do="start")
    bench.ask(do="resume")
    sent = [sent.command for _, sent in bench.station.sent]
    assert sent == [StartMission(plan.mission_hash), Resume(plan.mission_hash)]


async def test_an_upload_that_was_held_back_on_its_way_has_less_time_and_is_not_carried_out_later(bench: Bench) -> None:
    """The drone may be flying the mission that it would replace."""
    drone = bench.station.the_fog.drone(1)
    late = bench.ask(do="upload", name="two.plan", text=plan_text(), at_ms=now_ms() - 1000 * UPLOAD_TTL_S)
    assert late["error"].startswith("not sent: it was asked for 30.0 s before it came to the page's program")
    assert drone.uploaded == []
    bench.ask(do="upload", name="two.plan", text=plan_text(), at_ms=now_ms() - 20_000)
    await eventually(lambda: not bench.live.orders()[-1].waiting, "the upload")
    assert drone.upload_ttl_s == pytest.approx(10.0, abs=0.5)


async def test_a_start_behind_an_upload_flies_no_plan_of_before_it(bench: Bench) -> None:
    """The drone still has the mission of before, and would fly it."""
    bench.ask(do="upload", name="two.plan", text=plan_text())
    await eventually(lambda: not bench.live.orders()[-1].waiting, "the first upload")
    bench.ask(do="upload", name="other.plan", text=plan_text().replace("8.2", "8.3"))
    bench.ask(do="start")  # both clicks came together, as through a tunnel that stalled
    assert newest(bench.viewer)["words"][0]["text"].startswith("not sent: upload its plan first")
    assert bench.station.sent == []


async def test_an_upload_that_ends_while_a_newer_one_is_under_way_is_not_the_plan_to_fly(bench: Bench) -> None:
    drone = bench.station.the_fog.drone(1)
    first, second = asyncio.Event(), asyncio.Event()
    gates = [first, second]

    async def upload(plan: Plan, **more: Any) -> Outcome:
        drone.uploaded.append(plan)
        await gates.pop(0).wait()
        return outcome(Word.COMPLETED)

    drone.upload = upload  # type: ignore[method-assign]
    bench.ask(do="upload", name="two.plan", text=plan_text())
    bench.ask(do="upload", name="other.plan", text=plan_text().replace("8.2", "8.3"))
    await eventually(lambda: not gates, "both are under way")
    first.set()
    await eventually(lambda: not bench.live.orders()[0].waiting, "the first one's end")
    bench.ask(do="start")
    between = [*bench.station.sent]
    second.set()
    await eventually(lambda: not bench.live.orders()[1].waiting, "the second one's end")
    assert between == []
    bench.ask(do="start")
    assert [sent.command for _, sent in bench.station.sent] == [StartMission(drone.uploaded[1].mission_hash)]


async def test_a_plan_that_does_not_reach_its_drone_is_not_carried_out_hours_later(bench: Bench) -> None:
    bench.ask(do="upload", name="two.plan", text=plan_text())
    await eventually(lambda: not bench.live.orders()[-1].waiting, "the upload")
    assert bench.station.the_fog.drone(1).upload_timeout_s == CARRIED_S


async def test_a_file_is_looked_at_without_a_drone() -> None:
    async with Bench(watch_only=True).running() as bench:
        seen = bench.ask(do="look", name="two.plan", text=plan_text())["plan"]
        assert (seen["text"], seen["path"], seen["why"]) == ("2 mission items", [(47.1, 8.1), (47.2, 8.2)], None)
        assert [waypoint["altitude_m"] for waypoint in seen["draft"]["waypoints"]] == [20, 20]
        jump = plan_text().replace('"command": 16', '"command": 17')
        seen = bench.ask(do="look", name="two.plan", text=jump)["plan"]
        assert (seen["draft"], seen["why"]) == (None, "item 1 is MAV_CMD 17, and no waypoint")
        assert bench.ask(do="look", name="two.plan", text="{}")["error"].startswith("two.plan: plan: fileType")


async def test_an_upload_says_how_far_it_is(bench: Bench) -> None:
    bench.ask(do="upload", name="two.plan", text=plan_text())
    found: list[str | None] = []
    while bench.live.orders()[-1].waiting:
        if (orders := bench.viewer.take().get("orders")) is not None:
            found.append(orders[-1]["progress"])
        await asyncio.sleep(0)
    written = "1500 of 1500 bytes are at the drone; it writes the plan into its autopilot, and reads it back"
    assert found[-3:] == ["0 of 1500 bytes are at the drone", "1024 of 1500 bytes are at the drone", written]


async def test_of_a_files_mistakes_the_first_are_told_and_how_many_more(bench: Bench) -> None:
    document = json.loads(plan_text())
    document["mission"]["items"] = [{"type": "SimpleItem"}] * 6
    lines = bench.ask(do="upload", name="two.plan", text=json.dumps(document))["error"].splitlines()
    assert lines[0] == "two.plan: mission item 1: frame: expected 0 or 2 or 3 or 10, got None"
    assert (len(lines), lines[-1]) == (11, "and 14 more")
    assert bench.station.the_fog.drone(1).uploaded == []


async def test_a_plan_that_did_not_arrive_is_not_started(bench: Bench) -> None:
    drone = bench.station.the_fog.drone(1)
    for word in (TransferFailed("not carried"), outcome(Word.DENIED, reason="not_in_control")):
        drone.upload_word = word
        bench.ask(do="upload", name="two.plan", text=plan_text())
        await eventually(lambda: not bench.live.orders()[-1].waiting, "the upload")
        bench.ask(do="start")
    assert bench.station.sent == []


async def test_readings_are_sent_once_and_charts_are_bounded(bench: Bench) -> None:
    first = SensorReading(1, 1, 7, 1, 1, "temperature", 20.0, "C", 1000)
    bench.live.history.on_reading(first)
    (chart,) = bench.viewer.take()["sensors"]
    assert chart == {
        **{"fleet": "", "drone": 1, "sensor": 7, "kind": "temperature", "unit": "C"},
        "points": [[1000, 20.0]],
    }
    for number in range(2, MOST_POINTS + 10):
        bench.live.history.on_reading(replace(first, seq=number, time_ms=number, value=float(number)))
    (chart,) = bench.viewer.take()["sensors"]
    assert len(chart["points"]) == MOST_POINTS
    assert chart["points"][-1] == [MOST_POINTS + 9, MOST_POINTS + 9.0]
    assert "sensors" not in bench.viewer.take()
    for sensor in range(MOST_CHARTS + 1):
        bench.live.history.on_reading(replace(first, sensor=sensor))
    assert len(bench.live.history.charts) == MOST_CHARTS


async def test_what_a_browser_was_sent_is_remembered_only_of_charts_that_there_are() -> None:
    """A sensor may make up kinds without end; a chart that was dropped begins anew."""
    reading = SensorReading(1, 1, 7, 1, 1, "kind0", 20.0, "", 1000)
    history, sent = History(), dict[ChartKey, int]()
    for number in [*range(3 * MOST_CHARTS), 0]:
        history.on_reading(replace(reading, kind=f"kind{number}", seq=number))
        (chart,) = history.readings_since(sent)
        assert (chart["kind"], len(chart["points"])) == (f"kind{number}", 1)
    assert len(sent) <= MOST_CHARTS + 1


async def test_readings_from_before_the_page_was_open_are_there() -> None:
    station = FakeStation()
    station.the_fog.drone(2).readings.append(SensorReading(1, 2, 7, 1, 1, "humidity", 40.0, "%", 1000))
    live = Live(cast("GroundStation", station), cast("list[Fog]", [station.the_fog]), watch_only=True)
    (chart,) = live.enter().take()["sensors"]
    assert (chart["drone"], chart["kind"]) == (2, "humidity")


async def test_rankings_come_with_every_figure_and_reason(bench: Bench) -> None:
    bench.viewer.take()
    candidates = Candidate(drone=1, distance_m=10.0, arrival_s=2.0), Candidate(drone=2, reason="disarmed")
    await bench.station.heard.put(PsmiList(1, CommandId(7, 1), candidates[:1], candidates[1:], 1))
    await eventually(lambda: not bench.viewer.has_rankings, "the list")
    (psmi,) = bench.viewer.take()["rankings"]["lists"]
    assert psmi["listed"][0]["arrival_s"] == 2.0
    assert (psmi["left_out"][0]["reason"], psmi["left_out"][0]["plain"]) == ("disarmed", "disarmed")
    assert psmi["chosen"] == 1


async def test_a_page_that_ends_sends_nothing_more() -> None:
    async with Bench().running() as bench:
        pass
    assert "starting or ending: nothing was sent" in bench.ask()["error"]
    assert bench.station.sent == []


@pytest.mark.long
async def test_orders_are_bounded_and_so_is_what_is_remembered_of_them(bench: Bench) -> None:
    for seq in range(KEPT + 5):
        bench.ask()
        bench.station.sent[-1][1].words.put_nowait(outcome(Word.EXPIRED, seq=seq))
        await eventually(lambda: not bench.live.orders()[-1].waiting, "its last word")
    assert len(bench.live.orders()) == KEPT
    await bench.station.heard.put(outcome(Word.COMPLETED, seq=0, settled=True))
    await bench.station.heard.put(outcome(Word.COMPLETED, seq=KEPT, settled=True))
    await eventually(lambda: len(bench.live.orders()[KEPT - 5].words) == 2, "the truth of one that is kept")
    assert sum(len(order.words) for order in bench.live.orders()) == KEPT + 1


async def test_a_word_about_an_order_that_is_not_kept_any_more_keeps_nothing_of_it(bench: Bench) -> None:
    bench.ask()
    first = weakref.ref(bench.live.orders()[0])
    for _ in range(KEPT):
        bench.ask()
    words = bench.station.sent[0][1].words
    words.put_nowait(outcome(Word.ACCEPTED, seq=999))
    words.put_nowait(outcome(Word.FAILED, seq=999))
    await eventually(words.empty, "its words")
    bench.ask()
    bench.viewer.take()
    await eventually(lambda: gc.collect() is not None and first() is None, "it is forgotten")


async def test_what_ends_the_station_ends_the_page_with_its_one_line() -> None:
    bench = Bench()
    await bench.station.heard.put(BrokerRefused("cloud: not authorised"))
    with pytest.raises(BrokerRefused, match="not authorised"):
        await bench.live.run()


def asked_of_a_link(**more: Any) -> str:
    return json.dumps({"number": 5, "do": "link", "link": "air:uav1"} | more)


@pytest.mark.long
async def test_links_are_shown_and_changed_by_a_page_that_only_watches_drones_too() -> None:
    links = FakeLinks()
    async with Bench(watch_only=True, links=links).running() as bench:
        assert bench.viewer.take()["hello"]["links"] == "MQTT-XT"
        await eventually(lambda: bench.live.shown_links, "the links")
        up, down = bench.viewer.take()["links"]
        assert (up["name"], up["packets_per_s"], up["rate_bps"]) == ("air:uav1:up", 12.34, 20_000_000)
        assert (down["is_closed"], down["is_changed"]) == (True, True)
        said = bench.live.on_request(asked_of_a_link(figures={"delay": "300ms"}, closed=True))
        assert said == {"number": 5}
        bench.live.on_request(asked_of_a_link(back=True))
        await eventually(lambda: len(links.told) == 2, "both were told")
        assert links.told == [("air:uav1", {"delay": "300ms"}, True), "air:uav1"]
        await eventually(lambda: bench.live.shown_links[0]["delay_ms"] == 300.0, "the new delay")
        await eventually(lambda: "link air:uav1: as planned" in "".join(bench.live.log.lines()), "the log's lines")
        assert "link air:uav1: delay 300ms, closed" in "".join(bench.live.log.lines())


async def test_why_a_link_is_not_changed_is_told_to_everybody() -> None:
    links = FakeLinks()
    links.error = ConfigurationError("air:uav1:up: links are not shaped in this run")
    async with Bench(links=links).running() as bench:
        other = bench.live.enter()
        bench.live.on_request(asked_of_a_link(figures={"loss": "3%"}))
        await eventually(lambda: bench.viewer.answers and other.answers, "both browsers are told")
        assert other.take()["answers"] == [{"number": None, "error": str(links.error)}]


async def test_a_page_without_links_changes_none(bench: Bench) -> None:
    assert bench.viewer.take()["hello"]["links"] is None
    assert bench.live.on_request(asked_of_a_link())["error"] == "this page has no links to change"
