"""The kit's rules of section 20: the project's own roles keep them, and a role that breaks one is found by it."""

from __future__ import annotations

import asyncio
import socket
import sys
from collections.abc import Collection
from pathlib import Path

import pytest

from mqttxt.core.address import BrokerAddress
from mqttxt_conformance.activator_air import check_activator_air
from mqttxt_conformance.activator_kit import ActivatorTarget
from mqttxt_conformance.registry import RULES, Finding, Verdict
from mqttxt_conformance.uav_air import check_uav_air
from mqttxt_conformance.uav_kit import UavTarget
from tests import lateness
from tests.rigs import prefork
from tests.rigs.kit_checks import Checked, Expected, check, finder, said
from tests.rigs.processes import Broker, free_port

pytestmark = [
    pytest.mark.integration,
    pytest.mark.alone,
    pytest.mark.timeout(600),
    pytest.mark.soak("services/mqttxt/src", "tests/rigs/broken_roles.py"),
]

BROKEN = str(Path(__file__).parents[1] / "rigs" / "broken_roles.py")
UAV_VARIANTS = {
    "air-uav-greets-without-a-will": "greets-with-its-will",
    "air-uav-subscribes-to-what-is-kept": "subscribes-by-ids",
    "air-uav-marks-no-repetition": "repeats-what-is-not-answered",
    "air-uav-takes-repetitions": "takes-a-repetition-once",
    "air-uav-forgets-pieces": "takes-messages-together",
    "air-uav-takes-every-puback": "says-again-what-was-not-taken",
    "air-uav-waits-for-a-word": "asks-a-silent-gateway-and-leaves-it",
    "air-uav-repeats-states-at-once": "says-a-state-once",
    "air-uav-skips-message-ids": "its-packets-are-as-specified",
}
ACTIVATOR_VARIANTS = {
    "air-activator-marks-no-repetition": "repeats-what-is-not-answered",
    "air-activator-takes-repetitions": "takes-a-repetition-once",
    "air-activator-knows-no-names": "serves-by-names",
    "air-activator-serves-every-topic": "serves-a-drone-alone",
    "air-activator-passes-every-list": "lets-nobody-speak-to-all",
    "air-activator-keeps-the-will": "publishes-the-will",
    "air-activator-lets-newcomers-in": "keeps-who-is-there",
    "air-activator-says-nothing-to-strangers": "tells-strangers-to-come-anew",
    "air-activator-reflects": "is-no-amplifier",
    "air-activator-tells-one-by-one": "its-packets-are-as-specified",
}
OWN = {"none", "none-activator"}
EXPECTED = {
    **{name: Expected(set(), set()) for name in OWN},
    **{name: Expected({broken}) for name, broken in {**UAV_VARIANTS, **ACTIVATOR_VARIANTS}.items()},
}
AT_ONCE = 4
"""Checks that run side by side, each against an implementation of its own."""


class Checks:
    """Checks of this module, run together: most of their time they wait."""

    def __init__(self, folder: Path, names: Collection[str], at_once: int) -> None:
        self.folder = folder
        self.names = names
        self.cloud, self.fog = self.brokers = [Broker(folder, "cloud"), Broker(folder, "fog")]
        self.found: dict[str, list[Finding]] = {}
        self._gate = asyncio.Semaphore(at_once)

    async def run(self) -> None:
        jobs = [self._uav(name) for name in ["none", *UAV_VARIANTS] if name in self.names]
        names = ["none-activator", *ACTIVATOR_VARIANTS]
        jobs += [self._activator(name, fog) for fog, name in enumerate(names, start=1) if name in self.names]
        await asyncio.gather(*jobs)

    async def _uav(self, variant: str) -> None:
        port, gateway = free_port(socket.SOCK_DGRAM), free_port(socket.SOCK_DGRAM)
        files = ["--journal", str(self.folder / f"{variant}.journal")]
        line = _line(variant, "uav --drone {drone} --broker {broker} --autopilot {autopilot}", *files)
        target = UavTarget(7, "127.0.0.1", port, run=line, log=self.folder / f"{variant}.log")
        address = BrokerAddress("127.0.0.1", gateway, datagrams=True)
        async with self._gate:
            self.found[variant] = await check_uav_air(address, target, lambda finding: None)

    async def _activator(self, variant: str, fog: int) -> None:
        brokers = BrokerAddress.parse(self.cloud.url), BrokerAddress.parse(self.fog.url)
        options = "--fog {fog} --fog-root {fog_root} --drones {drones} --air-sn {air_sn}"
        line = _line(variant, "activator --cloud {broker} --fog-broker {fog_broker}", options)
        log = self.folder / f"{variant}.log"
        target, gateway = (
            ActivatorTarget(fog, fog_root=f"fog{fog}/local/", run=line, log=log),
            free_port(socket.SOCK_DGRAM),
        )
        async with self._gate:
            self.found[variant] = await check_activator_air(
                *brokers, ("127.0.0.1", gateway), target, lambda finding: None
            )


def _line(variant: str, *options: str) -> str:
    started = ["-m", "mqttxt"] if variant in OWN else [BROKEN, variant]
    return " ".join([sys.executable, *started, *options])


@pytest.fixture(scope="module")
def checks(tmp_path_factory: pytest.TempPathFactory) -> Checked:
    return check(finder(Checks), tmp_path_factory.mktemp("conformance"), EXPECTED, AT_ONCE)


@pytest.mark.parametrize(
    ("variant", "role"), [("none", "uav over datagrams"), ("none-activator", "activator over datagrams")]
)
def test_the_projects_own_role_keeps_every_rule(
    checks: Checked, variant: str, role: str, request: pytest.FixtureRequest
) -> None:
    found = checks.found[variant]
    assert said(found, Verdict.FAIL) == said(found, Verdict.NOT_TESTED) == {}
    assert [finding.rule for finding in found] == RULES[role]
    lateness.passes_alone(request.node, checks.beside_others.get(variant))


@pytest.mark.parametrize(("variant", "broken"), [*UAV_VARIANTS.items(), *ACTIVATOR_VARIANTS.items()])
def test_a_broken_role_fails_exactly_the_rule_that_it_breaks(
    checks: Checked, variant: str, broken: str, request: pytest.FixtureRequest
) -> None:
    failed = said(checks.found[variant], Verdict.FAIL)
    assert set(failed) == {broken}, failed
    lateness.passes_alone(request.node, checks.beside_others.get(variant))


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["uav", "--broker", "mqtt-sn://127.0.0.1", "--signed"], "--signed nor --second-broker beside it"),
        (["uav", "--broker", "mqtt-sn://127.0.0.1", "--run", "/nowhere/uav"], "--run '/nowhere/uav': No such file"),
        (
            ["activator", "--broker", "mqtt://127.0.0.1", "--fog-broker", "mqtt://127.0.0.1", "--air-sn", "7"],
            "HOST:PORT",
        ),
    ],
)
def test_what_a_person_gets_wrong_is_one_line_and_exit_code_2(arguments: list[str], line: str) -> None:
    done = prefork.run("mqttxt", "conformance", *arguments)
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    assert line in done.stderr.strip().splitlines()[-1]
