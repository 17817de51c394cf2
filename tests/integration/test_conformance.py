"""The conformance kit: the project's own roles keep every rule, and a role that breaks one is found by that rule."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
import subprocess
import sys
from collections.abc import AsyncIterator, Awaitable, Callable, Collection
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from mqttxt.core.address import BrokerAddress
from mqttxt.security.authority import Authority
from mqttxt.security.rights import Rights
from mqttxt_conformance.activator import ActivatorTarget, check_activator
from mqttxt_conformance.gs import GsTarget, check_gs
from mqttxt_conformance.registry import Finding, Verdict
from mqttxt_conformance.sealed import Folder
from mqttxt_conformance.uav import UavTarget, check_uav
from tests import lateness
from tests.rigs import prefork
from tests.rigs.kit_checks import Checked, Expected, check, finder, said
from tests.rigs.processes import Broker, free_port
from tests.rigs.secure import SecureBroker

SOURCES = ("services/mqttxt/src", "tests/rigs/broken_roles.py")
pytestmark = [
    pytest.mark.integration,
    pytest.mark.alone,
    pytest.mark.timeout(3600),
    pytest.mark.soak(*SOURCES),
]
NOT_STARTED = "uav-takes-retained"

BROKEN = str(Path(__file__).parents[1] / "rigs" / "broken_roles.py")
UAV_VARIANTS = {
    "uav-starts-late": {"does-not-start-late"},
    "uav-takes-any-session": {"executes-only-its-own-session"},
    "uav-executes-duplicates": {"answers-a-duplicate", "says-one-last-word"},
    "uav-repeats-late": {"does-not-repeat-late"},
    "uav-forgets-the-order": {"keeps-the-order"},
    "uav-takes-retained": {"refuses-what-is-retained"},
    "uav-obeys-everybody": {"obeys-only-the-holder"},
    "uav-writes-for-a-former-holder": {"writes-nothing-for-a-former-holder"},
    "uav-is-always-a-ground-station": {"is-a-ground-station-only-inside-the-lease"},
    "uav-repeats-behind-a-pilot": {"does-not-repeat-behind-a-pilot", "offboard-takes-nothing-from-a-pilot"},
    "uav-takes-one-refusal-for-all": {"takes-no-refusal-of-one-copy"},
    "uav-arms-again": {"does-not-arm-again-what-showed"},
    "uav-writes-behind-a-pilot": {"denies-what-waits-behind-a-pilot"},
    "uav-gives-modes-no-time": {
        *("gives-the-mode-its-time", "gives-the-landed-state-its-time", "tells-a-pilots-hold-from-a-climbs-end"),
    },
    "uav-takes-any-hold-for-a-climbs-end": {"tells-a-pilots-hold-from-a-climbs-end"},
    "uav-arms-in-any-mode": {"arms-in-hold"},
    "uav-holds-in-its-own-name": {"lets-no-hold-wait"},
    "uav-lets-a-disarm-wait": {"lets-no-disarm-wait"},
    "uav-holds-by-mode-alone": {"holds-by-where-it-is"},
    "uav-halts-by-heartbeats-alone": {"halts-without-a-heartbeat"},
    "uav-writes-what-is-flown-later": {"denies-what-would-be-flown-later"},
    "uav-believes-a-restart": {"believes-no-effect-of-a-restart"},
    "uav-holds-against-a-pilot": {"offboard-gives-way-to-a-pilot", "offboard-takes-nothing-from-a-pilot"},
    "uav-holds-once": {"offboard-commands-hold-until-it-shows"},
    "uav-says-nothing-anew": {"says-states-again-to-who-lacks-them", "says-nothing-that-it-does-not-know"},
    "uav-says-what-it-does-not-know": {"says-nothing-that-it-does-not-know"},
    "uav-does-not-ask-whether-it-is-heard": {"asks-whether-it-is-heard"},
    "uav-writes-parameters-again": {"sets-a-parameter"},
    "uav-guards-no-parameter": {"denies-what-must-not-be-set"},
    "uav-sets-parameters-late": {"sets-no-parameter-late"},
    "uav-gives-every-set-whole": {"gives-the-parameters"},
    "uav-asks-for-logs-armed": {"lists-logs-disarmed-alone"},
    "uav-reads-logs-first": {"commands-go-before-logs"},
}
STARTED_UAV_VARIANTS = {
    "uav-goes-on-after-a-stall": {"repeats-nothing-after-a-stall"},
    "uav-leaves-in-offboard": {"a-clean-stop-ends-offboard"},
    "uav-stays-deaf": {"leaves-a-connection-that-delivers-nothing"},
    "uav-audits-no-words": {"keeps-an-audit-log"},
}
KEYED_UAV_VARIANTS = {
    "uav-signs-for-another-link": {"signs-what-it-writes"},
    "uav-hears-what-is-not-signed": {
        *("hears-only-what-the-key-signs", "is-without-an-autopilot-that-does-not-sign"),
    },
}
KEYED_UAV = "uav-keyed"
"""The project's own UAV client with a MAVLink key."""
SIGNED_UAV_VARIANTS = {
    "uav-verifies-nothing": {"hears-only-what-is-signed"},
    "uav-takes-everybodys-session": {"leaves-a-session-to-its-owner"},
    "uav-asks-for-no-right": {"looks-at-the-right"},
    "uav-believes-the-route": {"is-due-at-the-earlier-deadline"},
    "uav-takes-anybodys-lease": {"takes-leases-of-its-fog-alone"},
    "uav-outlives-its-grant": {"control-ends-with-the-grant"},
    "uav-signs-no-words": {"signs-what-it-says"},
    "uav-forgets-the-question": {
        *("names-what-it-answers", "gives-the-parameters", "lists-logs-disarmed-alone", "commands-go-before-logs"),
    },
    "uav-goes-by-births-alone": {"leaves-a-session-to-its-owner"},
}
ACTIVATOR_VARIANTS = {
    "activator-keeps-the-gate-open": {"holds-states-back", "closes-the-gate", "passes-readings-on"},
    "activator-forwards-the-deadline": {"never-makes-a-deadline-later"},
    "activator-believes-every-epoch": {"counts-the-epochs-that-go-down"},
    "activator-says-two-last-words": {"says-one-last-word"},
    "activator-copies-the-expiry": {"sets-the-expiry-anew"},
    "activator-stamps-on-arrival": {"stamps-states-conservatively"},
    "activator-chooses-who-cannot-go": {"leaves-out-who-cannot-go"},
    "activator-chooses-behind-a-hold": {"chooses-nobody-behind-a-later-hold"},
    "activator-believes-every-puback": {"passes-readings-on"},
    "activator-answers-nothing-anew": {"answers-what-is-not-shown"},
    "activator-loses-a-word": {"loses-no-word-that-waits"},
    "activator-forgets-the-roster": {"loses-no-word-that-waits"},
    "activator-obeys-everybody": {"lets-one-station-command", "raises-the-epoch-at-a-takeover"},
    "activator-asks-all-at-once": {"asks-a-drone-in-turn"},
}
STARTED_ACTIVATOR_VARIANTS = {
    "activator-stays-deaf": {"leaves-a-connection-that-delivers-nothing"},
    "activator-audits-nobody": {"keeps-an-audit-log"},
}
GS_VARIANTS = {
    "gs-does-not-ask-whether-it-is-heard": {"asks-whether-it-is-heard"},
    "gs-counts-nothing": {"counts-by-one"},
    "gs-retains-commands": {"never-retains-a-command"},
    "gs-never-renews": {"renews-at-a-third"},
    "gs-gives-more-time": {"never-makes-a-deadline-later"},
    "gs-refreshes-what-it-sends-again": {"sends-the-same-bytes-again"},
    "gs-is-never-anew": {"marks-what-is-not-confirmed"},
    "gs-reads-no-words-together": {  # SIGTERM meets it while it waits for them
        *("reads-words-together", "is-quiet-after-the-last-word", "a-clean-stop-ends-the-lease"),
    },
    "gs-leaves-its-lease": {"a-clean-stop-ends-the-lease"},
}
SIGNED_GS_VARIANTS = {
    "gs-believes-anybody": {"believes-its-drone-alone", "sends-the-same-bytes-again"},
    "gs-counts-no-registrations": {"registers-for-a-session-and-counts"},
    "gs-grants-too-much": {"grants-its-control"},
    "gs-takes-any-reading": {"acknowledges-readings-that-are-signed"},
}
SIGNED_ACTIVATOR_VARIANTS = {
    "activator-forgets-the-route": {"makes-a-deadline-earlier"},
    "activator-registers-whatever-is-signed": {"registers-only-in-order"},
    "activator-signs-no-records": {"signs-what-it-says"},
    "activator-signs-drones-words": {"passes-on-a-drones-words-alone", "passes-on-words-together"},
    "activator-takes-any-reading": {"passes-on-readings-that-are-signed"},
    "activator-names-no-holder": {"orders-its-leases-and-names-the-holder"},
}
TWO_LINKS = "uav-two-links"
"""The project's own UAV client with two connections."""
TWO_LINKS_VARIANTS = {
    "uav-speaks-over-one": {"executes-once-what-comes-over-both", "answers-what-comes-over-the-other-afterwards"},
    "uav-executes-each-copy": {"answers-what-comes-over-the-other-afterwards"},
}
TWO_BROKERS = "activator-two-brokers"
TWO_BROKERS_VARIANTS = {
    "activator-believes-every-will": {"asks-before-a-will-of-several-is-the-end"},
    "activator-speaks-over-one": {"sends-safety-commands-over-both", "sends-again-over-both"},
}
SECURED = {"uav-in-tls": False, "uav-signed": True}
"""The project's own UAV client with an identity, and whether it signs."""
SECURED_GS = {"gs-in-tls": False, "gs-signed": True}
SIGNED_ACTIVATOR = "activator-signed"
SIGNED_VARIANTS = {**SIGNED_UAV_VARIANTS, **SIGNED_GS_VARIANTS, **SIGNED_ACTIVATOR_VARIANTS}
VARIANTS = {
    **UAV_VARIANTS,
    **STARTED_UAV_VARIANTS,
    **KEYED_UAV_VARIANTS,
    **TWO_LINKS_VARIANTS,
    **TWO_BROKERS_VARIANTS,
    **SIGNED_VARIANTS,
    **ACTIVATOR_VARIANTS,
    **STARTED_ACTIVATOR_VARIANTS,
    **GS_VARIANTS,
}
STARTED = {**STARTED_UAV_VARIANTS, **KEYED_UAV_VARIANTS, **STARTED_ACTIVATOR_VARIANTS}
"""Broken roles that the kit starts: without that, it could not test the rule that each breaks."""
OWN = ["uav", KEYED_UAV, TWO_LINKS, TWO_BROKERS, "activator", "gs", *SECURED, *SECURED_GS, SIGNED_ACTIVATOR]
UNHEARD = {"subscribes-before-it-registers"}
"""Not tested where an access list has no topic that nobody hears."""
UNSEEN = {"leaves-a-connection-that-delivers-nothing"}
"""Not tested over TLS, of which the kit can withhold nothing."""
NOT_TESTED = {
    "uav-in-tls": UNSEEN,
    "uav-signed": {"denies-without-a-deadline", *UNSEEN},
    "gs-signed": UNHEARD,
    "gs-in-tls": UNHEARD,
}
"""What the kit cannot test of the project's own roles."""
EXPECTED = {
    **{name: Expected(set(), NOT_TESTED.get(name, set())) for name in OWN},
    **{name: Expected(broken) for name, broken in VARIANTS.items()},
}
AT_ONCE = 16
"""Checks that run side by side, each against implementations of its own."""


class Checks:
    """Checks of this module, run together: most of their time they wait."""

    def __init__(self, folder: Path, names: Collection[str], at_once: int) -> None:
        self.folder = folder
        self.names = names
        self.cloud = Broker(folder, "cloud")
        self.fog = Broker(folder, "fog")
        self.second = Broker(folder, "second")
        self.authority = Authority.create(folder / "acme", "acme")
        self.drones = {name: 101 + number for number, name in enumerate([*SECURED, *SIGNED_UAV_VARIANTS])}
        for name in ("broker-fog1", "fog1", *(f"drone{number}" for number in self.drones.values())):
            self.authority.issue(name)
        self.authority.issue("gs-ops", Rights(None, set_parameters=True))
        self.authority.issue("gs-guest", Rights(observe=True))
        self.secured = SecureBroker(self.authority, "broker-fog1")
        self.stations = {name: own_fleet(folder / name) for name in [*SECURED_GS, *SIGNED_GS_VARIANTS]}
        names = [SIGNED_ACTIVATOR, *SIGNED_ACTIVATOR_VARIANTS]
        self.activators = {name: own_fleet(folder / name, "broker-fog1") for name in names}
        fleets = (*self.stations.values(), *self.activators.values())
        self.brokers = [self.cloud, self.fog, self.second, self.secured, *(each for _, own in fleets for each in own)]
        self.found: dict[str, list[Finding]] = {}
        self._gate = asyncio.Semaphore(at_once)

    async def run(self) -> None:
        jobs: dict[str, Callable[[], Awaitable[None]]] = {}
        for number, name in enumerate(["uav", *UAV_VARIANTS, *STARTED_UAV_VARIANTS], start=1):
            jobs[name] = partial(self._uav, name, number)
        for number, name in enumerate([KEYED_UAV, *KEYED_UAV_VARIANTS], start=81):
            jobs[name] = partial(self._uav, name, number, keyed=True)
        for number, name in enumerate([TWO_LINKS, *TWO_LINKS_VARIANTS], start=51):
            jobs[name] = partial(self._uav, name, number, two=True)
        for number, name in enumerate(["activator", *ACTIVATOR_VARIANTS, *STARTED_ACTIVATOR_VARIANTS], start=1):
            jobs[name] = partial(self._activator, name, number)
        for number, name in enumerate([TWO_BROKERS, *TWO_BROKERS_VARIANTS], start=51):
            jobs[name] = partial(self._activator, name, number, two=True)
        for number, name in enumerate(["gs", *GS_VARIANTS], start=101):
            jobs[name] = partial(self._gs, name, number)
        for name in self.drones:
            jobs[name] = partial(self._secured_uav, name, signed=SECURED.get(name, True))
        for name in self.stations:
            jobs[name] = partial(self._secured_gs, name, signed=SECURED_GS.get(name, True))
        for name in self.activators:
            jobs[name] = partial(self._signed_activator, name)
        assert set(jobs) == set(EXPECTED)
        await asyncio.gather(*(jobs[name]() for name in jobs if name in self.names))

    async def _uav(self, variant: str, drone: int, two: bool = False, keyed: bool = False) -> None:
        options = ["--second-broker", "{second_broker}"] if two else []
        options += ["--mavlink-key", "{mavlink_key}"] if keyed else []
        second = BrokerAddress.parse(self.second.url) if two else None
        await self._check_uav(variant, drone, BrokerAddress.parse(self.fog.url), options, second=second)

    async def _secured_uav(self, variant: str, signed: bool) -> None:
        drone, options = self.drones[variant], ["--identity", "{identity}"]
        options += ["--signed", "--fog", "{fog}"] if signed else []
        folder = Folder(self.authority.folder, signed)
        await self._check_uav(variant, drone, self.secured.address, options, folder=folder)

    async def _check_uav(self, variant: str, drone: int, broker: BrokerAddress, options: list[str], **how: Any) -> None:
        port, log = free_port(socket.SOCK_DGRAM), self.folder / f"{variant}.log"
        usual = ["--drone", "{drone}", "--broker", "{broker}", "--autopilot", "{autopilot}"]
        usual += ["--journal", str(self.folder / f"{variant}.journal")]
        values = {"drone": str(drone), "broker": str(broker), "autopilot": f"udp:127.0.0.1:{port}", "fog": "1"}
        values |= {"second_broker": self.second.url, "identity": str(self.authority.folder / f"drone{drone}")}
        async with self._gate, self._implementation("uav", variant, [*usual, *options], values) as line:
            target = UavTarget(drone, "127.0.0.1", port, run=line, log=log, **how)
            self.found[variant] = await check_uav(broker, target, lambda finding: None)

    async def _activator(self, variant: str, fog: int, two: bool = False) -> None:
        root = f"fog{fog}/local/"
        options = ["--fog-root", "{fog_root}", *(["--second-fog-broker", "{second_fog_broker}"] if two else [])]
        brokers = BrokerAddress.parse(self.cloud.url), BrokerAddress.parse(self.fog.url)
        second = BrokerAddress.parse(self.second.url) if two else None
        await self._check_activator(variant, fog, *brokers, options, fog_root=root, second=second)

    async def _signed_activator(self, variant: str) -> None:
        folder, (cloud, fog) = self.activators[variant]
        options = ["--identity", "{identity}", "--signed", "--signed-readings"]
        signing = Folder(folder, True, signed_readings=True)
        await self._check_activator(variant, 1, cloud.address, fog.address, options, folder=signing)

    async def _check_activator(
        self, variant: str, fog: int, cloud: BrokerAddress, fogs: BrokerAddress, options: list[str], **how: Any
    ) -> None:
        usual = ["--fog", "{fog}", "--drones", "{drones}", "--cloud", "{broker}", "--fog-broker", "{fog_broker}"]
        values = {"fog": str(fog), "drones": "1,2", "broker": str(cloud), "fog_broker": str(fogs)}
        values |= {"fog_root": how.get("fog_root", ""), "second_fog_broker": self.second.url}
        values["identity"] = str(how["folder"].path / "fog1") if "folder" in how else ""
        async with self._gate, self._implementation("activator", variant, [*usual, *options], values) as line:
            target = ActivatorTarget(fog, run=line, log=self.folder / f"{variant}.log", **how)
            self.found[variant] = await check_activator(cloud, fogs, target, lambda finding: None)

    async def _gs(self, variant: str, fog: int) -> None:
        await self._check_gs(variant, fog, BrokerAddress.parse(self.cloud.url), [])

    async def _secured_gs(self, variant: str, signed: bool) -> None:
        folder, (broker,) = self.stations[variant]
        signing = Folder(folder, signed, signed_readings=signed)
        words = ["{identity}", *(["signed"] if signed else [])]
        await self._check_gs(variant, 1, broker.address, words, folder=signing)

    async def _check_gs(self, variant: str, fog: int, broker: BrokerAddress, words: list[str], **how: Any) -> None:
        what = "none" if variant in OWN else variant
        line = " ".join([sys.executable, BROKEN, what, "gs", "{broker}", "{fog}", "{drone}", *words])
        target = GsTarget(fog, drone=1, run=line, log=self.folder / f"{variant}.log", **how)
        async with self._gate:
            self.found[variant] = await check_gs(broker, target, lambda finding: None)

    @contextlib.asynccontextmanager
    async def _implementation(
        self, role: str, variant: str, options: list[str], values: dict[str, str]
    ) -> AsyncIterator[str | None]:
        """The command line with which the kit starts it; a broken one runs already, unless its rule needs a start."""
        if variant in OWN or variant in STARTED:
            what = ["-m", "mqttxt"] if variant in OWN else [BROKEN, variant]
            audit = [] if variant == SIGNED_ACTIVATOR else ["--audit", "{audit}"]  # the kit audits no signed activator
            yield " ".join([sys.executable, *what, role, *options, *audit])
            return
        line = [sys.executable, BROKEN, variant, role, *options]
        with (self.folder / f"{variant}.log").open("ab") as log:
            process = subprocess.Popen([part.format(**values) for part in line], stdout=log, stderr=log)
        try:
            yield None
        finally:
            process.kill()
            process.wait()


def own_fleet(folder: Path, *more: str) -> tuple[Path, list[SecureBroker]]:
    """A fleet with a cloud's broker, and with `more` of them: stations of one cloud could not all be `ops`."""
    folder.mkdir()
    authority = Authority.create(folder / "acme", "acme")
    brokers = ("broker-cloud", *more)
    for name in (*brokers, "fog1", "drone1", "drone2", "sensor4"):
        authority.issue(name)
    authority.issue("gs-ops", Rights(None, take_over=True, observe=True))
    authority.issue("gs-guest", Rights(observe=True))
    return authority.folder, [SecureBroker(authority, name) for name in brokers]


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> Checked:
    """The project's own roles, and one that the kit does not start."""
    expected = {name: EXPECTED[name] for name in (*OWN, NOT_STARTED)}
    return check(finder(Checks), tmp_path_factory.mktemp("own"), expected, AT_ONCE)


@pytest.fixture(scope="module")
def broken(tmp_path_factory: pytest.TempPathFactory) -> Checked:
    expected = {name: EXPECTED[name] for name in VARIANTS}
    return check(finder(Checks), tmp_path_factory.mktemp("broken"), expected, AT_ONCE)


@pytest.mark.parametrize("role", OWN)
def test_the_projects_own_role_keeps_every_rule(own: Checked, role: str, request: pytest.FixtureRequest) -> None:
    found = own.found[role]
    assert said(found, Verdict.FAIL) == {}
    assert set(said(found, Verdict.NOT_TESTED)) == EXPECTED[role].not_tested
    signed = any(finding.rule.check.__module__.endswith("_signed") for finding in found)
    assert signed is role.endswith("-signed")
    assert found
    lateness.passes_alone(request.node, own.beside_others.get(role))


@pytest.mark.soak(*SOURCES, too_long=True)
@pytest.mark.parametrize("variant", VARIANTS)
def test_a_broken_role_fails_exactly_the_rules_that_it_breaks(
    broken: Checked, variant: str, request: pytest.FixtureRequest
) -> None:
    failed = said(broken.found[variant], Verdict.FAIL)
    assert set(failed) == VARIANTS[variant], failed
    lateness.passes_alone(request.node, broken.beside_others.get(variant))


def test_what_needs_an_implementation_that_the_kit_starts_says_so(own: Checked) -> None:
    left = said(own.found[NOT_STARTED], Verdict.NOT_TESTED)
    assert "a-clean-stop-says-down" in left
    assert "needs --run" in left["a-clean-stop-says-down"]


def _run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return prefork.run("mqttxt", "conformance", *arguments)


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["activator", "--fog-broker", "mqtt://127.0.0.1:1"], "--fog-broker mqtt://127.0.0.1:1: no broker answers"),
        (["gs", "--run", "/nowhere/station"], "--run '/nowhere/station': No such file"),
    ],
)
def test_what_a_person_gets_wrong_beside_a_broker_is_one_line_and_exit_code_2(
    broker: Broker, arguments: list[str], line: str
) -> None:
    done = _run(*arguments, "--broker", broker.url)
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    assert line in done.stderr.strip().splitlines()[-1]


def test_an_implementation_that_never_appears_fails_its_birth_and_the_exit_code_says_so(broker: Broker) -> None:
    port = free_port(socket.SOCK_DGRAM)
    address = ["--broker", broker.url, "--autopilot", f"udp:127.0.0.1:{port}"]
    done = _run("uav", *address, "--run", f"{sys.executable} -c 0", "--format", "json")
    report = json.loads(done.stdout)
    assert done.returncode == 1
    assert (report["pass"], report["fail"]) == (0, 1)
    (failed,) = [row for row in report["findings"] if row["verdict"] == "fail"]
    assert failed["rule"] == "birth-carries-the-session"
    assert "R9.1" in failed["numbers"]
