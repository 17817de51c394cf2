"""The live page of two fleets whose drones have the same numbers, in a real Chromium: one table, one map, one log."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.rigs.fleets import TwoFleets
from tests.rigs.live_page import NEEDS_BROWSER, LivePage, done
from tests.rigs.served_page import Served

pytestmark = [pytest.mark.integration, NEEDS_BROWSER]
ROWS = "[...document.querySelectorAll('#fleet-rows tr')]"
EU_1 = "tr[data-drone='acme/eu/1/1']"
ARM = 400


@pytest.fixture(scope="module")
def page(two: TwoFleets) -> Iterator[Served]:
    served = Served(two.folder, two.cloud, "page", fogs=("acme/1", "acme/eu/1"))
    yield served
    served.process.kill()


def is_ready(browser: LivePage) -> None:
    browser.until(
        f"{ROWS}.length === 4 && {ROWS}.every(row => row.textContent.includes('this station'))",
        "all four are controlled",
    )


def test_drones_of_two_fleets_are_in_one_table_on_one_map_and_in_one_log(page: Served, browser: LivePage) -> None:
    browser.open(page.url)
    is_ready(browser)
    rows = browser.value(f"{ROWS}.map(row => [...row.children].slice(1, 4).map(cell => cell.textContent))")
    assert rows == [["1", "acme", "1"], ["2", "acme", "1"], ["1", "acme/eu", "1"], ["2", "acme/eu", "1"]]
    heads = browser.value("[...document.querySelectorAll('#fleet-head th')].slice(1, 4).map(head => head.textContent)")
    assert heads == ["Drone", "Fleet", "Fog"]
    browser.until("document.querySelectorAll('[data-marker]').length === 4", "all on the map")
    assert browser.text("#fogs") == "Fog acme/1: heard, Fog acme/eu/1: heard"
    browser.until("document.getElementById('log').textContent.includes('drone acme/eu/1')", "in the log")
    assert browser.violations() == []
    assert browser.wider() == []


def test_a_command_of_the_page_reaches_the_selected_fleets_drone_alone(
    two: TwoFleets, page: Served, browser: LivePage
) -> None:
    browser.open(page.url)
    is_ready(browser)
    browser.click(f"{EU_1} th")
    browser.until_text("#who", "Drone acme/eu/1")
    browser.click("#send-arm")
    done(browser, "arm to drone acme/eu/1")
    assert (len(two.eu.commanded(1, ARM)), two.acme.flown(1), two.eu.flown(2)) == (1, {}, {})
    browser.click("[data-marker='acme/1/2'] path")
    browser.until("document.querySelectorAll('#fleet-rows .selected').length === 2", "the map selects in the table")
    browser.until_text("#who", "Drone acme/2, acme/eu/1")
    browser.click(f"{EU_1} th")
    browser.click("#send-arm")
    done(browser, "arm to drone acme/2")
    assert (len(two.acme.commanded(2, ARM)), len(two.eu.commanded(1, ARM)), two.acme.flown(1)) == (1, 1, {})


def test_a_broadcast_of_the_page_is_one_fogs_of_one_fleet(two: TwoFleets, page: Served, browser: LivePage) -> None:
    browser.open(page.url)
    is_ready(browser)
    before = two.acme.flown(1), two.acme.flown(2)
    browser.click("[id='to-fog-acme/eu/1']")
    browser.until_text("#who", "All drones of fog acme/eu/1")
    browser.click("#send-arm")
    done(browser, "arm to all drones of fog acme/eu/1", drones=2)
    assert (two.acme.flown(1), two.acme.flown(2)) == before
    assert len(two.eu.commanded(2, ARM)) == 1


async def test_a_page_of_one_fleet_that_is_still_open_commands_nobody(two: TwoFleets, page: Served) -> None:
    """Its drone 1 has no fleet: it is no drone of this page's."""
    arms = [len(fleet.commanded(1, ARM)) for fleet in (two.acme, two.eu)]
    answer = await page.ask(do="command", command="arm", to={"drones": [[1, 1]]})
    assert "order" in answer, "it is shown as not sent"
    assert [len(fleet.commanded(1, ARM)) for fleet in (two.acme, two.eu)] == arms


def test_on_a_phone_each_row_names_its_fleet(page: Served, browser: LivePage) -> None:
    browser.open(page.url, 400)
    is_ready(browser)
    assert browser.wider() == []
    assert browser.value(f"document.querySelector(\"{EU_1} td[data-heading='Fleet']\").textContent") == "acme/eu"
    assert browser.said == []
