"""The live page during a flight: mqttxt's page, with the traffic and the figures of the links."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from mqttxt import FogUnreachable, GroundStation
from mqttxt.errors import ConfigurationError
from mqttxt.page.links import LinkFigures
from mqttxt.page.process import serve
from mqttxt.security.fleet import FLEET_FILE, REVOKED_FILE
from mqttxt.security.identity import CERTIFICATE_FILE, KEY_FILE

from ..errors import TestbedError
from ..plan.fleet import Fleet
from ..plan.identities import PAGE, identity_of
from .live_links import Ask, changes, read_live_plan, tell
from .results import LINKS, LINKS_EVENTS, read_json_lines
from .traffic import Carried, Traffic

HOST = "127.0.0.1"
TITLES = {"mqttxt": "MQTT-XT", "mavlink": "MAVLink"}
QUEUE = "100 packets"
"""The queue of a link that is given a rate by hand."""
CONNECT_S = 5.0
"""How long the page waits for fogs before it starts. It goes on connecting afterwards; over MAVLink there are none."""


class PageLinks:
    """The links of a running fleet, for its page (`mqttxt.page.links.Links`).

    Parameters:
        protocol: the protocol that is flown.
        folder: the run's folder.
        fleet: the running fleet.
        ask: runs a short command in `net`.

    Raises DockerError if the plan of the links cannot be read.
    """

    def __init__(self, protocol: str, folder: Path, fleet: Fleet, ask: Ask) -> None:
        self.title = TITLES[protocol]
        self._events = folder / LINKS / LINKS_EVENTS
        self._ask = ask
        self._plan = read_live_plan(ask)
        self._topology = fleet.topology(sensors=any(name.startswith("sense:") for name in self._plan.links))
        self._traffic = Traffic(folder / "pcap", self._topology)
        self._by_hand: dict[str, dict[str, str]] = {}

    def look(self) -> list[LinkFigures]:
        """Every directed link: its traffic, and its steady figures with the changes in force now."""
        traffic, over = self._traffic.look(), self._changed()
        found = []
        for name, planned in self._plan.links.items():
            change = over.get(name, {})
            figures = asdict(planned) | change
            carried = traffic.get(name, Carried())
            found.append(
                LinkFigures(
                    name,
                    carried.packets_per_s,
                    carried.bytes_per_s,
                    figures["rate_bps"],
                    figures["delay_us"] / 1000,
                    figures["loss"],
                    bool(figures.get("closed")),
                    bool(change),
                )
            )
        return found

    def change(self, name: str, figures: Mapping[str, str], closed: bool) -> None:
        """Change both directions of a link, as `testbed link` does."""
        typed = self._by_hand.get(name, {}) | dict(figures)
        if typed.get("rate", "unlimited") != "unlimited":
            typed["queue"] = QUEUE
        else:
            typed.pop("queue", None)
        if typed or closed:
            self._tell(name, typed, closed=closed)
        else:
            self._tell(name, {}, back=True)
        self._by_hand[name] = typed

    def put_back(self, name: str) -> None:
        """Put a link back to its profile's figures."""
        self._tell(name, {}, back=True)
        self._by_hand.pop(name, None)

    def _tell(self, name: str, typed: Mapping[str, str], *, closed: bool = False, back: bool = False) -> None:
        try:
            for change in changes(self._plan, self._topology, name, typed, closed=closed, back=back):
                tell(self._ask, change)
        except TestbedError as error:
            raise ConfigurationError(str(error)) from error

    def _changed(self) -> dict[str, dict[str, Any]]:
        """The changes in force on each link: the newest one by hand, else the newest of each other cause."""
        newest: dict[str, dict[str, dict[str, Any]]] = {}
        for event in read_json_lines(self._events, frozenset({"t_ns"})):
            if "link" in event:
                newest.setdefault(event["link"], {})[event["cause"]] = event["change"] or {}
        return {link: by_cause.get("hand") or _joined(by_cause) for link, by_cause in newest.items()}


async def serve_page(
    protocol: str, folder: Path, fleet: Fleet, asks: Callable[[str], Ask], security: str, port: int, watch_only: bool
) -> None:
    """Serve the page of a running fleet until cancelled; its station is at the cloud broker and uses no links.

    Parameters:
        protocol: the protocol that is flown.
        folder: the run's folder.
        fleet: the running fleet.
        asks: returns, for a service's name, the function that runs a short command there.
        security: the factor SECURITY: none, tls or signed.
        port: the page's port, on the loopback interface only.
        watch_only: whether the page takes no control.

    Raises DockerError if the plan of the links cannot be read, and what `mqttxt.page.process.serve` raises.
    """
    secured = protocol == "mqttxt" and security != "none"
    links = PageLinks(protocol, folder, fleet, asks("net"))
    with contextlib.ExitStack() as stack:
        how: dict[str, Any] = {"control": not watch_only, "insecure": not secured, "name": None if secured else PAGE}
        if secured:
            own = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="mqttxt-page-")))
            copy_identity(asks("gs"), own)
            how |= {"identity": own, "signed": security == "signed"}
        async with GroundStation(fleet.broker_url("cloud", secured=secured), **how) as station:
            with contextlib.suppress(FogUnreachable):
                await station.connect(fleet.fogs, CONNECT_S)
            await serve(station, [station.fog(fog) for fog in fleet.fogs], HOST, port, watch_only, links)


def copy_identity(ask: Ask, folder: Path) -> None:
    """Copy the page's identity from the in-memory volume into `folder`, for as long as the page runs."""
    for name in (KEY_FILE, CERTIFICATE_FILE, FLEET_FILE, REVOKED_FILE):
        path = folder / name
        path.touch(mode=0o600)
        path.write_text(ask(["cat", f"{identity_of(f'gs-{PAGE}')}/{name}"]), encoding="ascii")


def _joined(by_cause: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    return {field: value for change in by_cause.values() for field, value in change.items()}
