"""Two fleets that sign, each with an authority and a cloud broker of its own: a right is one of one fleet."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from mqttxt import ConfigurationError, Fleets, FogUnreachable, GroundStation
from mqttxt.security.identity import Identity
from tests.rigs.processes import commanded, eventually
from tests.rigs.secure import Node
from tests.rigs.secure_system import SecureSystem

pytestmark = pytest.mark.integration

ARM = 400


class TwoAuthorities:
    """Both authorities are called `acme`, and both fleets have a fog 1, a drone 1, `gs-ops` and `gs-view`."""

    def __init__(self, folder: Path) -> None:
        for name in ("one", "two"):
            (folder / name).mkdir()
        self.acme = SecureSystem(folder / "one", True, prefix="acme/")
        self.north = SecureSystem(folder / "two", True, prefix="north/")


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TwoAuthorities]:
    made = TwoAuthorities(tmp_path_factory.mktemp("authorities"))
    with closing(made.acme), closing(made.north):
        made.acme.start()
        made.north.start()
        yield made


def station(at: SecureSystem, prefix: str, of: SecureSystem, name: str) -> GroundStation:
    return GroundStation(at.cloud_url, prefix=prefix, identity=of.acme.folder / name, signed=True, signed_readings=True)


def arms(of: SecureSystem) -> int:
    return len(commanded(of.folder / "sitl.jsonl", ARM))


async def test_who_may_command_in_one_fleet_may_only_watch_in_the_other(two: TwoAuthorities) -> None:
    """R2.4, R11.3, R12.2."""
    ops, view = station(two.acme, "acme/", two.acme, "gs-ops"), station(two.north, "north/", two.north, "gs-view")
    async with Fleets(ops, view) as fleets:
        assert fleets.name == "ops, view"
        await fleets.connect({"acme": [1], "north": [1]})
        mine, theirs = fleets.fog("acme/1").drone(1), fleets.fog("north/1").drone(1)
        await eventually(lambda: mine.is_controlled and theirs.is_reachable, "one is controlled, one is seen")
        last = await mine.arm()
        assert (last.completed, last.fleet, last.signer) == (True, "acme", "drone1")
        with pytest.raises(ConfigurationError, match="mqttxt:may/command/1"):
            theirs.arm()
        with pytest.raises(ConfigurationError, match="mqttxt:may/take-over"):
            await theirs.take_over()
        await eventually(lambda: theirs.states, "who may observe hears states")
        assert (await mine.disarm()).completed
    assert (arms(two.acme), arms(two.north)) == (2, 0)


async def test_an_identity_of_one_fleet_is_worth_nothing_in_the_other(two: TwoAuthorities) -> None:
    before = arms(two.north)
    async with Fleets(
        station(two.acme, "acme/", two.north, "gs-ops"), station(two.north, "north/", two.acme, "gs-ops")
    ) as fleets:
        with pytest.raises(FogUnreachable, match=r"fleet acme: fog 1: no connection.*; fleet north: fog 1: no conn"):
            await fleets.connect({"acme": [1], "north": [1]}, timeout_s=3)
    with pytest.raises(OSError):  # noqa: PT011 - TLS says it in words of its own
        Node(Identity.load(two.acme.acme.folder / "gs-ops"), two.north.cloud)
    assert arms(two.north) == before


def test_two_identities_of_one_authority_are_refused(two: TwoAuthorities) -> None:
    with pytest.raises(ConfigurationError, match="of the same authority as that of fleet acme"):
        Fleets(station(two.acme, "acme/", two.acme, "gs-ops"), station(two.acme, "north/", two.acme, "gs-view"))
