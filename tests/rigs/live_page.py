"""The live page in headless Chromium, used by mouse and keyboard as by a person."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

from tests.rigs.browser import Browser, Navigated
from tests.rigs.processes import PATIENCE_S, listens, wait_until
from tests.tools.axe import AXE
from tests.tools.programs import chromium

_KEYS = {"Tab": 9, "Enter": 13, " ": 32, "ArrowLeft": 37, "ArrowUp": 38, "ArrowRight": 39, "ArrowDown": 40}
NEEDS_BROWSER = pytest.mark.skipif(
    chromium() is None or not AXE.exists(), reason="no Chromium or axe-core; `make tools` has them"
)
REACHABLE, CONTROL, ARMED, HEIGHT = 3, 4, 5, 8
"""Columns of the fleet's table."""
TALLEST = 4000


def _text_of(selector: str) -> str:
    return f"(document.querySelector({json.dumps(selector)})?.textContent ?? '')"


class LivePage(Browser):
    """A browser with one live page open."""

    def __init__(self) -> None:
        program = chromium()
        assert program is not None, "there is no Chromium: make tools"
        super().__init__(program)

    def open(self, url: str, width: int = 1600, dark: bool = False) -> None:
        """Show the page at a width once it is served, and wait until it shows drones."""
        served = urlsplit(url)
        assert served.hostname is not None
        assert served.port is not None
        port, host = served.port, served.hostname
        # Until then the browser shows an error page of its own, whose pictures would be taken for the page's.
        wait_until(lambda: listens(port, host), f"{url} is served")
        self.own = (url, "file:")
        self.said.clear()
        self.resize(width, dark)
        self.show(url)
        self.until("document.querySelectorAll('#fleet-rows tr').length > 0", "drones on the page")

    def cut_off(self, *files: str) -> None:
        """Block these files from now on, as when the network changes; without any, unblock all."""
        self._ask("Network.setBlockedURLs", urls=[f"*/{name}" for name in files])

    def set_time_zone(self, name: str) -> None:
        """Set the browser's time zone, from the next page on; an empty `name` is UTC."""
        self._ask("Emulation.setTimezoneOverride", timezoneId=name)

    def value(self, expression: str) -> Any:
        """The value of a JavaScript expression; promises are awaited."""
        told = self._ask("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in told, told
        return told["result"].get("value")

    def until(self, expression: str, what: str, limit_s: float = PATIENCE_S) -> None:
        def holds() -> object:
            try:
                return self.value(expression)
            except Navigated:
                return False

        try:
            wait_until(holds, what, limit_s)
        except AssertionError as error:
            where = self.value("location.href + ', ' + document.readyState")
            raise AssertionError(f"{error}; {where} said {self.said}") from error

    def text(self, selector: str) -> str:
        return str(self.value(_text_of(selector)))

    def until_text(self, selector: str, part: str, limit_s: float = PATIENCE_S) -> None:
        self.until(f"{_text_of(selector)}.includes({json.dumps(part)})", f"{part!r} in {selector}", limit_s)

    def click(self, selector: str, across: float = 0.5, down: float = 0.5) -> None:
        """Click with the mouse, in the middle of an element, or at other shares of its width and height."""
        found = f"document.querySelector({json.dumps(selector)})"
        self.value(f"{found}.scrollIntoView({{block: 'center', behavior: 'instant'}})")
        box = self.value(f"{found}.getBoundingClientRect().toJSON()")
        at = {"x": box["x"] + box["width"] * across, "y": box["y"] + box["height"] * down}
        for kind in ("mousePressed", "mouseReleased"):
            self._ask("Input.dispatchMouseEvent", type=kind, **at, button="left", clickCount=1)

    def drag(self, selector: str, right: float, down: float) -> None:
        """Drag with the mouse, from the middle of an element, by `right` and `down` pixels."""
        box = self.value(f"document.querySelector({json.dumps(selector)}).getBoundingClientRect().toJSON()")
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        there = {"x": x + right, "y": y + down}
        pressed = {"button": "left", "clickCount": 1}
        self._ask("Input.dispatchMouseEvent", type="mousePressed", x=x, y=y, **pressed)
        for at in ({"x": x + right / 2, "y": y + down / 2}, there):
            self._ask("Input.dispatchMouseEvent", type="mouseMoved", **at, button="left", buttons=1)
        self._ask("Input.dispatchMouseEvent", type="mouseReleased", **there, **pressed)

    def pinch(self, selector: str, apart: float, later: float) -> None:
        """Pinch with two fingers in the middle of an element: first `apart`, then `later` pixels from each other."""
        box = self.value(f"document.querySelector({json.dumps(selector)}).getBoundingClientRect().toJSON()")
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        self._ask("Emulation.setTouchEmulationEnabled", enabled=True, maxTouchPoints=2)
        for kind, between in (("touchStart", apart), ("touchMove", later)):
            fingers = [{"x": x + side * between / 2, "y": y, "id": id} for id, side in enumerate((-1, 1))]
            self._ask("Input.dispatchTouchEvent", type=kind, touchPoints=fingers)
        self._ask("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])

    def watch_inputs(self) -> None:
        """Count presses of the mouse's button and of keys on this page from now on."""
        self.value(
            """window.inputs = {mouse: 0, keys: 0};
            addEventListener('pointerdown', () => { window.inputs.mouse += 1; }, true);
            addEventListener('keydown', () => { window.inputs.keys += 1; }, true)"""
        )

    def inputs(self) -> tuple[int, int]:
        """How often the mouse's button was pressed, and keys."""
        found = self.value("window.inputs")
        return int(found["mouse"]), int(found["keys"])

    def keep_downloads(self, folder: Path) -> None:
        """Save downloads in `folder`."""
        self._ask("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(folder))

    def choose(self, selector: str, path: Path) -> None:
        """Choose a file in a file input."""
        root = self._ask("DOM.getDocument")["root"]["nodeId"]
        node = self._ask("DOM.querySelector", nodeId=root, selector=selector)["nodeId"]
        self._ask("DOM.setFileInputFiles", nodeId=node, files=[str(path)])

    def press(self, key: str, shift: bool = False) -> None:
        """Press a key, given by its name or its character."""
        text = "\r" if key == "Enter" else key if len(key) == 1 else ""
        # Only letters and digits have their character's code: a full stop's is Delete's.
        code = _KEYS.get(key, ord(key.upper()) if key.isalnum() and len(key) == 1 else 0)
        how = {"key": key, "windowsVirtualKeyCode": code, "modifiers": 8 if shift else 0}
        self._ask("Input.dispatchKeyEvent", type="keyDown", **how, **({"text": text} if text else {}))
        self._ask("Input.dispatchKeyEvent", type="keyUp", **how)

    def hold(self, key: str, times: int) -> None:
        """Hold a key that repeats `times` times."""
        how = {"key": key, "windowsVirtualKeyCode": _KEYS[key], "text": "\r" if key == "Enter" else ""}
        for repeated in range(times + 1):
            self._ask("Input.dispatchKeyEvent", type="keyDown", **how, autoRepeat=repeated > 0)
        self._ask("Input.dispatchKeyEvent", type="keyUp", key=key, windowsVirtualKeyCode=_KEYS[key])

    def type(self, selector: str, text: str) -> None:
        """Replace a field's text."""
        self.click(selector)
        self.value("document.activeElement.select()")
        self._ask("Input.insertText", text=text)

    def press_all(self, text: str) -> None:
        """Type a text key by key; in a field reached by Tab, the old text is selected and so replaced."""
        for key in text:
            self.press(key)

    def tab_to(self, selector: str) -> None:
        """Move the focus to an element by the Tab key alone."""
        for _ in range(200):
            if self.value(f"document.activeElement.matches({json.dumps(selector)})"):
                return
            self.press("Tab")
        raise AssertionError(f"{selector}: the Tab key does not lead there")

    def violations(self) -> list[str]:
        """The violations that axe-core finds."""
        self.value(f"{AXE.read_text()}; 0")
        found = self.value(
            "axe.run().then(r => r.violations.map(v => v.id + ': ' + v.nodes.map(n => n.html).join(' ')))"
        )
        assert isinstance(found, list)
        return found

    def wider(self) -> list[str]:
        """Elements that overflow the page on the right, except those in a box that scrolls."""
        found = self.value(
            """(() => { const wide = document.documentElement.clientWidth;
              const scrolls = e => { for (let p = e; p; p = p.parentElement)
                if (p.id === 'map' || ['auto', 'scroll'].includes(getComputedStyle(p).overflowX)) return true;
                return false; };
              return [...document.body.querySelectorAll('*')].filter(e => e.getBoundingClientRect().right > wide + 1
                && !scrolls(e)).map(e => e.outerHTML.slice(0, 80)); })()"""
        )
        assert isinstance(found, list)
        return found

    def picture(self, path: Path, width: int, dark: bool = False) -> None:
        """Write a PNG of the whole page, at most TALLEST pixels high."""
        self.resize(width, dark)
        height = min(TALLEST, int(self.value("document.documentElement.scrollHeight")))
        self.resize(width, dark, height)
        self.value(
            "window.scrollTo(0, 0); new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"
        )
        path.write_bytes(base64.b64decode(self._ask("Page.captureScreenshot", format="png")["data"]))


def cell(drone: int, column: int) -> str:
    return f"tr[data-drone='1/{drone}'] td:nth-of-type({column})"


def last_words(browser: LivePage, word: str) -> int:
    """How many drones have answered the newest command with this word."""
    return int(browser.value(f"document.querySelectorAll('#orders > li:first-child li[data-word={word}]').length"))


def done(browser: LivePage, text: str, drones: int = 1) -> None:
    """Wait until the newest command is `text` and `drones` drones have completed it."""
    browser.until_text("#orders > li:first-child h3", text)
    wait_until(lambda: last_words(browser, "completed") == drones, f"{text}: {browser.text('#orders')}", 60)


def is_ready(browser: LivePage, *drones: int) -> None:
    for drone in drones:
        browser.until_text(cell(drone, REACHABLE), "yes")
        browser.until_text(cell(drone, CONTROL), "this station")
        browser.until_text(cell(drone, ARMED), "no")
