"""Two fleets whose fogs and drones have the same numbers, in one cloud: what is asked of one never reaches the other.

What the autopilots received says so, not what the stations heard.
"""

from __future__ import annotations

from collections.abc import AsyncIterator

import pytest

from mqttxt import Arm, Disarm, Fleets, FogUnreachable, Goto, GroundStation, Land, Outcome, Plan, PsmiList, Takeoff
from tests.rigs import prefork
from tests.rigs.fleets import TwoFleets
from tests.rigs.processes import ROOT, eventually

pytestmark = pytest.mark.integration

SURVEY = ROOT / "tests" / "unit" / "mqttxt" / "plans" / "survey.plan"
NEAR = Goto(47.397742, 8.546526, 8)


@pytest.fixture
async def fleets(two: TwoFleets) -> AsyncIterator[Fleets]:
    stations = [GroundStation(two.cloud.url, name="ops", prefix=prefix) for prefix in ("acme/", "acme/eu/")]
    async with Fleets(*stations) as joined:
        await joined.connect({"acme": [1], "acme/eu": [1]})
        await eventually(lambda: is_controlled(joined, 4), "all four drones are controlled")
        yield joined


def is_controlled(fleets: Fleets, drones: int) -> bool:
    return len([drone for drone in fleets.drones if drone.is_reachable and drone.is_controlled]) == drones


async def test_a_command_and_a_broadcast_reach_the_drones_of_their_own_fleet_alone(
    two: TwoFleets, fleets: Fleets
) -> None:
    assert (await fleets.drone("acme/eu/1").arm()).completed
    assert (two.eu.flown(1), two.eu.flown(2), two.acme.flown(1), two.acme.flown(2)) == ({"arm": 1}, {}, {}, {})
    said = await fleets.fog("acme/1").broadcast(Arm())
    assert [(outcome.fleet, outcome.drone, outcome.completed) for outcome in said] == [
        ("acme", 1, True),
        ("acme", 2, True),
    ]
    assert (two.acme.flown(1), two.acme.flown(2)) == ({"arm": 1}, {"arm": 1})
    assert (two.eu.flown(1), two.eu.flown(2)) == ({"arm": 1}, {})
    for drone in ("acme/1", "acme/2", "acme/eu/1"):
        assert (await fleets.drone(drone).send(Disarm())).completed


@pytest.mark.soak("services/mqttxt/src/mqttxt/activator", "services/mqttxt/src/mqttxt/station")
async def test_the_first_of_all_fleets_is_sent_and_nobody_of_the_other(two: TwoFleets, fleets: Fleets) -> None:
    before = two.acme.flown(1), two.acme.flown(2)
    flier = fleets.drone("acme/eu/2")
    for command in (Arm(), Takeoff(10)):
        assert (await flier.send(command)).completed
    said = [event async for event in fleets.best(NEAR, ttl_s=20)]
    offers = {event.fleet: event.chosen for event in said if isinstance(event, PsmiList)}
    assert offers["acme/eu"] == 2
    last = said[-1]
    assert isinstance(last, Outcome)
    assert (last.fleet, last.drone, last.completed) == ("acme/eu", 2, True)
    assert (two.acme.flown(1), two.acme.flown(2)) == before, "nobody flies there"
    assert "reposition" not in two.eu.flown(1)
    assert (await flier.send(Land())).completed


async def test_plans_parameters_logs_and_control_are_of_one_fleet(two: TwoFleets, fleets: Fleets) -> None:
    there, other = fleets.drone("acme/eu/1"), fleets.drone("acme/1")
    before = two.acme.flown(1)
    plan = Plan.load(SURVEY)
    assert (await there.upload(plan)).completed
    assert (await there.download()).mission_hash == plan.mission_hash
    assert not (await other.download()).content.mission
    speed = (await there.parameters())["MPC_XY_CRUISE"] + 1
    assert (await there.set_parameter("MPC_XY_CRUISE", speed)).completed
    assert (await there.parameters())["MPC_XY_CRUISE"] == speed
    assert (await other.parameters())["MPC_XY_CRUISE"] == speed - 1
    assert await there.logs() is not None
    async with GroundStation(two.cloud.url, name="rival", prefix="acme/eu/") as rival:
        (fog,) = await rival.connect([1])
        await fog.drone(1).take_over()
        await eventually(lambda: not there.is_controlled, "the other station has it")
        assert (there.holder, other.holder, other.is_controlled) == ("rival", "ops", True)
        assert not (await there.arm()).completed
        assert (await other.arm()).completed
        assert (await other.disarm()).completed
    await there.take_over()
    assert (await there.clear_plan()).completed
    assert two.acme.flown(1) == {**before, "arm": before.get("arm", 0) + 2}


async def test_a_fleet_whose_fog_is_gone_says_so_and_the_other_one_flies(two: TwoFleets, fleets: Fleets) -> None:
    two.eu.activator.kill()
    try:
        await eventually(lambda: not fleets.fog("acme/eu/1").is_live, "the cloud says the activator's will")
        assert (fleets.fog("acme/1").is_live, is_controlled(fleets, 2)) == (True, True)
        with pytest.raises(FogUnreachable):
            fleets.fog("acme/eu/1").drone(1).hold()
        assert (await fleets.drone("acme/1").arm()).completed
        assert (await fleets.drone("acme/1").disarm()).completed
    finally:
        two.eu.activator.start().wait_ready()
    await eventually(lambda: is_controlled(fleets, 4), "control of it is back")


async def test_what_a_station_leaves_behind_is_said_in_each_fleet(two: TwoFleets) -> None:
    """MQTT has one will a connection: with one for all, the other fleets would not hear of a station that died."""
    stations = [GroundStation(two.cloud.url, name="lost", prefix=prefix) for prefix in ("acme/", "acme/eu/")]
    async with Fleets(*(GroundStation(two.cloud.url, prefix=p, control=False) for p in ("acme/", "acme/eu/"))) as seen:
        await seen.connect({"acme": [1], "acme/eu": [1]})
        lost = Fleets(*stations)
        await lost.__aenter__()
        await lost.connect({"acme": [1], "acme/eu": [1]})
        await eventually(lambda: all(drone.holder == "lost" for drone in seen.drones), "it has all")
        for station in stations:
            for link in station._runner.links.values():
                link._connection.close(with_will=True)  # type: ignore[union-attr]
                link._is_closed = True
        await eventually(lambda: all(drone.holder is None for drone in seen.drones), "each activator has heard", 20)
        await lost.__aexit__(None, None, None)


def gs(two: TwoFleets, *typed: str) -> tuple[int, str]:
    done = prefork.run("mqttxt", "gs", *typed, "--cloud", two.cloud.url)
    return done.returncode, done.stdout + done.stderr


def test_a_drone_is_named_with_its_fleet_at_the_command_line(two: TwoFleets) -> None:
    before = two.acme.flown(1), two.acme.flown(2), two.eu.flown(1)
    code, said = gs(two, "send", "arm", "--drone", "acme/eu/2")
    assert (code, "drone 2: arm completed" in said) == (0, True), said
    code, said = gs(two, "send", "disarm", "--drone", "2", "--fog", "acme/eu/1")
    assert code == 0, said
    assert (two.acme.flown(1), two.acme.flown(2), two.eu.flown(1)) == before
    code, said = gs(two, "watch", "--fog", "acme/1", "--fog", "acme/eu/1")
    assert code == 0, said
    assert all(name in said for name in ("acme/1", "acme/2", "acme/eu/1", "acme/eu/2")), said


@pytest.mark.parametrize(
    ("typed", "says"),
    [
        ("send arm --drone acme/1 --fog acme/eu/1", "expected a drone and a fog of one fleet"),
        ("send arm --drone acme/1 --prefix acme/eu", "expected one of the fleet of --prefix acme/eu"),
        ("watch --fog 1 --fog acme/1", "expected FLEET/NUMBER of each fog"),
        ("watch --fog acme/1 --fog ACME/1", "a second one; expected another for each fleet"),
        ("mavlink --fog acme/1 --fog acme/eu/1 --listen tcp:127.0.0.1:5760", "MAVLink's ids are per fleet"),
        ("send arm --fog acme/1 --fog acme/eu/1", "expected one, or --best"),
        ("send arm --fog acme/fog1/local/1", "fog1 leads topics of a fleet"),
    ],
)
def test_what_would_mix_fleets_is_refused_before_anything_is_connected_to(
    two: TwoFleets, typed: str, says: str
) -> None:
    code, said = gs(two, *typed.split())
    assert (code, says in said, len(said.splitlines())) == (2, True, 1), said
