"""Headless Chromium over its debugging pipe: a page's layout at a width, in light or dark, and its errors."""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any

from tests.rigs.processes import wait_until

ANSWER_S = 60.0
NETWORK_CHANGED = "net::ERR_NETWORK_CHANGED"
"""Chromium's error for connections cut because an interface came or went, as those of other tests' containers do."""


@dataclass(frozen=True)
class Look:
    """A page as it was shown."""

    width: int
    scroll_width: int
    wider: tuple[str, ...]
    """Elements that overflow on the right, except those in a box that scrolls."""
    cut: tuple[str, ...]
    """Elements partly hidden in a box that scrolls: on paper that part is lost."""
    background: str
    ink: str
    text_sizes: tuple[float, ...]
    """The displayed text sizes of the visible figures, in pixels."""
    visible_figures: int


_MEASURE = """(() => {
  const wide = document.documentElement.clientWidth;
  const scrolls = e => { for (let p = e; p; p = p.parentElement)
    if (['auto', 'scroll'].includes(getComputedStyle(p).overflowX)) return true; return false; };
  const wider = [...document.body.querySelectorAll('*')]
    .filter(e => e.getBoundingClientRect().right > wide + 1 && !scrolls(e))
    .map(e => e.tagName + '.' + (e.getAttribute('class') || '') + ' ' + (e.textContent || '').slice(0, 30));
  const seen = [...document.querySelectorAll('figure svg')].filter(e => e.getBoundingClientRect().width > 0);
  const sizes = seen.flatMap(s => { const shown = s.getBoundingClientRect().width / s.viewBox.baseVal.width;
    return [...s.querySelectorAll('text')].map(t => parseFloat(getComputedStyle(t).fontSize) * shown); });
  const cut = [...document.querySelectorAll('.scroll')].filter(e => e.scrollWidth > e.clientWidth + 1)
    .map(e => (e.textContent || '').trim().slice(0, 40));
  const style = getComputedStyle(document.body);
  return {scroll: document.documentElement.scrollWidth, wider, cut, background: style.backgroundColor, ink: style.color,
    sizes, figures: seen.length};
})()"""


class Navigated(Exception):
    """The page navigated elsewhere before it had answered."""


@dataclass
class Browser:
    """One Chromium for many pages; `said` has console messages, exceptions and failed loads."""

    path: str
    said: list[str] = field(default_factory=list)
    own: tuple[str, ...] = ("file:", "data:")
    """The prefixes of the addresses that a page may request."""
    _loaded: int = 0
    _session: str | None = None

    def __enter__(self) -> Browser:
        self._folder = tempfile.TemporaryDirectory()
        read_theirs, self._write = os.pipe()
        self._read, write_theirs = os.pipe()
        options = (
            *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--hide-scrollbars"),
            *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
            *("--remote-debugging-pipe", f"--user-data-dir={self._folder.name}", "about:blank"),
        )
        command = f'exec "$@" 3<&{read_theirs} 4>&{write_theirs}'
        self._process = subprocess.Popen(
            ["bash", "-c", command, "bash", self.path, *options],
            pass_fds=(read_theirs, write_theirs),
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        os.close(read_theirs)
        os.close(write_theirs)
        self._rest, self._number = b"", 0
        target = next(t for t in self._ask("Target.getTargets")["targetInfos"] if t["type"] == "page")
        self._session = self._ask("Target.attachToTarget", targetId=target["targetId"], flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self._ask(f"{domain}.enable")
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._process.terminate()
        self._process.wait(20)
        os.close(self._read)
        os.close(self._write)
        wait_until(self._is_cleared, "no process of the browser writes into its folder any more")

    def _is_cleared(self) -> bool:
        """Kill its other processes, which outlive the first one, and remove its folder; False: try again."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        try:
            self._folder.cleanup()
        except OSError:
            return False
        return True

    def pids(self) -> list[int]:
        """The ids of its processes."""
        found = []
        for path in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(ProcessLookupError):
                if os.getpgid(int(path.name)) == self._process.pid:
                    found.append(int(path.name))
        return found

    def look(self, page: Path, width: int, dark: bool = False, paper: bool = False) -> Look:
        """Show a page at a width in CSS pixels, whole, as on a screen or as on paper."""
        self.resize(width, dark, 900, paper)
        self.show(page.resolve().as_uri())
        found = self._ask("Runtime.evaluate", expression=_MEASURE, returnByValue=True)["result"]["value"]
        return Look(
            *(width, found["scroll"], tuple(found["wider"]), tuple(found["cut"]), found["background"], found["ink"]),
            *(tuple(found["sizes"]), found["figures"]),
        )

    def resize(self, width: int, dark: bool, height: int = 1000, paper: bool = False) -> None:
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
        self._ask("Emulation.setDeviceMetricsOverride", **size)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self._ask("Emulation.setEmulatedMedia", features=[scheme], media="print" if paper else "screen")

    def show(self, url: str) -> None:
        """Load a page completely."""
        loaded = self._loaded
        while (why := self._ask("Page.navigate", url=url).get("errorText")) == NETWORK_CHANGED:
            pass
        assert why is None, f"{url}: {why}"
        while self._loaded == loaded:
            self._next()

    def _ask(self, method: str, **params: Any) -> dict[str, Any]:
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": params}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        while True:
            told = self._next()
            if told.get("id") == self._number:
                if told.get("error", {}).get("message") == "Inspected target navigated or closed":
                    raise Navigated
                assert "error" not in told, told
                found: dict[str, Any] = told["result"]
                return found

    def _next(self) -> dict[str, Any]:
        while b"\0" not in self._rest:
            ready, _, _ = select.select([self._read], [], [], ANSWER_S)
            assert ready, "Chromium says nothing"
            more = os.read(self._read, 1 << 20)
            assert more, "Chromium ended"
            self._rest += more
        line, self._rest = self._rest.split(b"\0", 1)
        told: dict[str, Any] = json.loads(line)
        method, params = told.get("method", ""), told.get("params", {})
        if method == "Page.loadEventFired":
            self._loaded += 1
        if method == "Runtime.consoleAPICalled":
            self.said.append(str([one.get("value") for one in params["args"]]))
        if method == "Runtime.exceptionThrown":
            self.said.append(params["exceptionDetails"]["text"])
        if method == "Log.entryAdded" and NETWORK_CHANGED not in params["entry"]["text"]:
            self.said.append(params["entry"]["text"])
        if method == "Network.requestWillBeSent" and not params["request"]["url"].startswith(self.own):
            self.said.append(f"asked for {params['request']['url']}")
        return told
