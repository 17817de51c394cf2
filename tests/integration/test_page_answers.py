"""What the live page answers, and where: before a made-up fleet, in a real Chromium."""

from __future__ import annotations

import asyncio

import pytest

from mqttxt import CommandId, ControlChanged, Word
from tests.rigs.live_page import LivePage
from tests.rigs.made_up_page import served, shown
from tests.rigs.processes import free_port
from tests.simulation.page_fleet import FakeStation, outcome
from tests.tools.axe import AXE
from tests.tools.programs import chromium

pytestmark = [
    pytest.mark.integration,
    pytest.mark.skipif(chromium() is None, reason="no Chromium; `make tools` has it"),
]
PHONE, DESK = 400, 1600
FOCUS = "document.activeElement.id"


def is_in_sight(selector: str) -> str:
    box = f"document.querySelector('{selector}').getBoundingClientRect()"
    return f"{box}.height > 0 && {box}.top >= 0 && {box}.bottom <= innerHeight"


async def test_enter_and_keys_that_send_nothing_say_why() -> None:
    station = FakeStation()
    async with shown(station) as browser:

        async def refused(key: str, why: str) -> None:
            await asyncio.to_thread(browser.press, key)
            await asyncio.to_thread(browser.until_text, "#notice", why)

        await asyncio.to_thread(browser.tab_to, "#takeoff-altitude_m")
        await refused("Enter", "Take off was not sent: select a drone first.")
        await asyncio.to_thread(browser.click, "#select-all")
        await asyncio.to_thread(browser.until, "document.getElementById('notice').textContent === ''", "no stale word")
        await asyncio.to_thread(browser.tab_to, "#goto-latitude_deg")
        await refused("Enter", "Go to was not sent: it takes one drone.")
        await asyncio.to_thread(browser.click, "#to-best")
        await refused("l", "Land was not sent: only Go to is for whoever arrives first.")
        assert station.sent == []


async def test_whoever_has_selected_one_drone_and_commands_all_is_told() -> None:
    async with shown(FakeStation()) as browser:
        await asyncio.to_thread(browser.click, "#to-fog-1")
        await asyncio.to_thread(browser.until_text, "#who", "All drones of fog 1; Go to takes one drone")
        await asyncio.to_thread(browser.click, "tr[data-drone='1/1'] th")
        await asyncio.to_thread(browser.until_text, "#who", "All drones of fog 1, not the selected alone;")


@pytest.mark.parametrize("width", [PHONE, DESK])
async def test_the_words_of_the_newest_command_are_in_sight_of_its_button(width: int) -> None:
    station = FakeStation()
    async with shown(station, width=width) as browser:
        await asyncio.to_thread(browser.click, "tr[data-drone='1/1'] input")
        for number, (button, word, is_bad) in enumerate(
            [("#send-arm", Word.COMPLETED, False), ("#send-takeoff", Word.FAILED, True)]
        ):
            await asyncio.to_thread(browser.click, button)
            await asyncio.to_thread(browser.until_text, "#newest", "to drone 1: sent")
            _, sent = station.sent[number]
            sent.words.put_nowait(outcome(Word.IN_PROGRESS))
            sent.words.put_nowait(outcome(word))
            await asyncio.to_thread(browser.until_text, "#newest", f"to drone 1: in progress, {word.label}")
            assert await asyncio.to_thread(browser.value, is_in_sight("#newest"))
            assert await asyncio.to_thread(browser.value, "document.querySelector('#newest').matches('.bad')") == is_bad


async def test_why_not_is_said_in_plain_words_with_the_code_as_a_tip() -> None:
    station = FakeStation()
    async with shown(station) as browser:
        await asyncio.to_thread(browser.click, "tr[data-drone='1/1'] input")
        for number, (said, why, code) in enumerate(
            [
                (
                    outcome(Word.DENIED, reason="on_ground"),
                    "The drone is on the ground: let it take off first.",
                    "denied(on_ground)",
                ),
                (
                    outcome(Word.SUPERSEDED, superseded_by=CommandId(7, 2)),
                    "A later command took its place.",
                    "superseded(by 00000007:2)",
                ),
            ]
        ):
            await asyncio.to_thread(browser.click, "#send-hold")
            await asyncio.to_thread(browser.until_text, "#newest", "hold to drone 1: sent")
            station.sent[number][1].words.put_nowait(said)
            station.heard.put_nowait(said)
            await asyncio.to_thread(browser.until_text, "#newest", f"hold to drone 1: {said.word.label}. ")
            await asyncio.to_thread(browser.until_text, "#log li", said.word.label)
            for place in ("#newest", "#orders > li:first-child", "#log li"):
                text = await asyncio.to_thread(browser.text, place)
                assert why in text
                assert "(" not in text, "no code of the specification"
            for place in ("#orders > li:first-child strong", "#log li"):
                tip = await asyncio.to_thread(browser.value, f"document.querySelector('{place}').title")
                assert tip == f"drone 1: takeoff {code}"


async def test_whose_the_drones_are_is_said_before_they_are_commanded() -> None:
    station = FakeStation()
    drone = station.the_fog.drone(2)
    drone.holder, drone.is_controlled = "rival", False
    async with shown(station) as browser:
        await asyncio.to_thread(browser.until, "document.querySelector('#send-arm') !== null", "the commands")
        assert await asyncio.to_thread(browser.text, "#holders") == ""
        await asyncio.to_thread(browser.click, "#select-all")
        await asyncio.to_thread(browser.until_text, "#holders", "rival controls drone 2: take control first")
        await asyncio.to_thread(browser.click, "#to-fog-1")
        assert await asyncio.to_thread(browser.text, "#holders") == "rival controls drone 2"
        drone.holder, drone.is_controlled = "page", True
        station.heard.put_nowait(ControlChanged(1, 2, "page", True, 2))
        await asyncio.to_thread(browser.until, "document.querySelector('#holders').textContent === ''", "it is ours")


async def test_of_many_drones_of_others_the_number_is_said() -> None:
    station = FakeStation(drones=9)
    for drone in station.the_fog.drones:
        drone.holder, drone.is_controlled = "page", False
    async with shown(station) as browser:
        await asyncio.to_thread(browser.click, "#to-fog-1")
        await asyncio.to_thread(browser.until_text, "#holders", "another page controls 9 of these drones")


@pytest.mark.parametrize("width", [PHONE, DESK])
async def test_that_the_pages_program_is_gone_is_in_sight_and_its_values_look_old(width: int) -> None:
    station, port = FakeStation(), free_port()
    line = "getComputedStyle(document.querySelector('#fleet-rows td[data-heading=Armed] span')).textDecorationLine"
    with LivePage() as browser:
        async with served(station, port) as url:
            await asyncio.to_thread(browser.open, url, width)
            await asyncio.to_thread(browser.until_text, "#connection", "connected to")
            await asyncio.to_thread(browser.value, "scrollTo({top: 900, behavior: 'instant'})")
            assert await asyncio.to_thread(browser.value, line) == "none"
        await asyncio.to_thread(browser.until_text, "#notice", "The page's program does not answer.")
        assert await asyncio.to_thread(browser.value, is_in_sight("#notice"))
        assert await asyncio.to_thread(browser.value, line) == "line-through"
        async with served(station, port):
            await asyncio.to_thread(browser.until, "document.querySelector('#notice').textContent === ''", "it is back")
            assert await asyncio.to_thread(browser.value, line) == "none"


@pytest.mark.skipif(not AXE.exists(), reason="no axe-core; `make tools` has it")
@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("width", [PHONE, DESK])
async def test_a_notice_and_a_refusal_keep_nobody_out(width: int, dark: bool) -> None:
    station = FakeStation()
    async with shown(station, width=width) as browser:
        await asyncio.to_thread(browser.resize, width, dark)
        await asyncio.to_thread(browser.click, "tr[data-drone='1/1'] input")
        await asyncio.to_thread(browser.click, "#send-arm")
        await asyncio.to_thread(browser.until_text, "#newest", "sent")
        station.sent[0][1].words.put_nowait(outcome(Word.DENIED, reason="not_in_control, rival"))
        drone = station.the_fog.drone(1)
        drone.holder, drone.is_controlled = "rival", False
        station.heard.put_nowait(ControlChanged(1, 1, "rival", False, 2))
        await asyncio.to_thread(browser.until_text, "#notice", "rival has it.")
        await asyncio.to_thread(browser.until_text, "#newest", "Another ground station controls the drone: rival.")
        await asyncio.to_thread(browser.value, "document.querySelector('#send-takeoff').scrollIntoView({block: 'end'})")
        apart = "document.querySelector('#newest').getBoundingClientRect().bottom"
        apart += " - document.querySelector('#notice').getBoundingClientRect().top"
        assert await asyncio.to_thread(browser.value, f"{apart} <= 0.5"), "one does not cover the other"
        assert await asyncio.to_thread(browser.violations) == []
        assert await asyncio.to_thread(browser.wider) == []
        assert browser.said == []


@pytest.mark.parametrize("width", [PHONE, DESK])
async def test_a_notice_is_in_sight_and_moves_no_button(width: int) -> None:
    station = FakeStation()
    async with shown(station, width=width) as browser:
        for down in (0, 900):
            await asyncio.to_thread(browser.value, f"scrollTo({{top: {down}, behavior: 'instant'}})")
            place = "document.querySelector('#send-arm').getBoundingClientRect().top"
            before = await asyncio.to_thread(browser.value, place)
            drone = station.the_fog.drone(1)
            for holder, is_ours in (("rival", False), ("page", True)):
                drone.holder, drone.is_controlled = holder, is_ours
                station.heard.put_nowait(ControlChanged(1, 1, holder, is_ours, 2))
                said = "" if is_ours else "Control of drone 1 is lost: rival has it."
                wanted = f"document.getElementById('notice').textContent === '{said}'"
                await asyncio.to_thread(browser.until, wanted, said)
                assert await asyncio.to_thread(browser.value, place) == before
                assert await asyncio.to_thread(browser.value, is_in_sight("#notice")) != is_ours


async def test_two_fingers_zoom_the_map_and_are_no_click() -> None:
    async with shown(FakeStation(), width=PHONE) as browser:
        await asyncio.to_thread(browser.until, "document.querySelectorAll('[data-marker]').length === 2", "the drones")
        await asyncio.to_thread(browser.value, "document.querySelector('#map').scrollIntoView({block: 'center'})")
        before = await asyncio.to_thread(browser.text, "#map-scale")
        await asyncio.to_thread(browser.pinch, "#map", 60, 60)
        await asyncio.to_thread(browser.pinch, "#map", 40, 160)
        await asyncio.to_thread(
            browser.until, f"document.getElementById('map-scale').textContent !== '{before}'", "it is larger"
        )
        assert await asyncio.to_thread(browser.value, "document.getElementById('goto-latitude_deg').value") == ""
        assert await asyncio.to_thread(browser.text, "#who") == "Nobody: select a drone"


async def test_the_focus_stays_when_a_fog_is_not_heard_any_more() -> None:
    station = FakeStation()
    async with shown(station) as browser:
        await asyncio.to_thread(browser.click, "#to-fog-1")
        station.the_fog.is_live = False
        await asyncio.to_thread(browser.until_text, "#fogs", "NOT HEARD")
        assert await asyncio.to_thread(browser.value, FOCUS) == "to-fog-1"


@pytest.mark.parametrize("names", [("page", "page"), ("gs-0a1b2c3d", "gs-4e5f6071")])
async def test_what_was_typed_stays_when_the_pages_program_comes_back(names: tuple[str, str]) -> None:
    """Without an identity its station has another name at each start."""
    station, port = FakeStation(), free_port()
    station.name, comes_back_as = names
    with LivePage() as browser:
        async with served(station, port) as url:
            await asyncio.to_thread(browser.open, url)
            await asyncio.to_thread(browser.until_text, "#connection", "connected to")
            await asyncio.to_thread(browser.type, "#takeoff-altitude_m", "12.5")
        await asyncio.to_thread(browser.until_text, "#connection", "does not answer")
        await asyncio.to_thread(browser.value, "document.getElementById('station').textContent = ''")
        station.name = comes_back_as
        async with served(station, port):
            await asyncio.to_thread(browser.until_text, "#station", station.name)
            await asyncio.to_thread(browser.until_text, "#connection", "connected to")
            value = "document.getElementById('takeoff-altitude_m').value"
            assert await asyncio.to_thread(browser.value, value) == "12.5"
            assert await asyncio.to_thread(browser.value, FOCUS) == "takeoff-altitude_m"
