"""Every role with every identity that is wrong: one line that says what to do, exit code 2, and no connection."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from typer.testing import CliRunner

import sensor.cli
from mqttxt import ConfigurationError, GroundStation
from mqttxt.cli.main import app
from mqttxt.core.address import BrokerAddress
from mqttxt.core.transport import Transport
from mqttxt.security.access_list import Place, entries
from mqttxt.security.authority import Authority
from mqttxt.security.identity import Identity
from mqttxt.security.names import NodeName
from mqttxt.security.rights import Rights

pytestmark = pytest.mark.long

OPS = Rights(None, take_over=True)
ROLES = {
    "fog1": "activator --fog 1 --listen 127.0.0.1:1 --cloud {url} --identity {identity}",
    "drone1": "uav --drone 1 --journal {folder}/journal --broker {url} --identity {identity}",
    "gs-ops": "gs send arm --cloud {url} --identity {identity}",
    "sensor1": "sensor --broker {url} --number 1 --identity {identity}",
    "broker-cloud": "broker cloud --out {folder}/out --identity {identity}",
}


class Bench:
    """A node's identity, beside that of its broker, and a listener that nobody may reach."""

    def __init__(self, folder: Path, name: str) -> None:
        self.acme = Authority.create(folder / "acme", "acme")
        self.name = name
        self.folder = folder
        self.issue()
        if name == "fog1":
            self.acme.issue("broker-fog1")

    @property
    def identity(self) -> Path:
        return self.acme.folder / self.name

    def issue(self, days: float = 10, not_before: datetime | None = None) -> None:
        self.acme.issue(self.name, OPS if self.name == "gs-ops" else None, days, not_before=not_before)

    def issue_again(self, days: float, not_before: datetime) -> None:
        self.identity.rename(self.identity.with_name("old"))
        self.issue(days, not_before)

    def put(self, file: str, other: Path) -> None:
        (self.identity / file).write_bytes((other / file).read_bytes())


def expired(bench: Bench) -> None:
    bench.issue_again(1, datetime.now(UTC) - timedelta(days=2))


def not_yet_valid(bench: Bench) -> None:
    bench.issue_again(1, datetime.now(UTC) + timedelta(days=1))


def revoked(bench: Bench) -> None:
    bench.acme.revoke(bench.name)


def of_another_fleet(bench: Bench) -> None:
    theirs = Authority.create(bench.folder / "theirs", "acme")
    other = theirs.issue(bench.name, OPS if bench.name == "gs-ops" else None)
    for file in ("identity.pem", "certificate.pem"):
        bench.put(file, other)


def self_signed(bench: Bench) -> None:
    (bench.identity / "certificate.pem").write_bytes((bench.acme.folder / "fleet.pem").read_bytes())


def of_another_name(bench: Bench) -> None:
    other = bench.acme.issue("sensor9")
    bench.identity.rename(bench.identity.with_name("old"))
    other.rename(bench.identity)


def key_of_another(bench: Bench) -> None:
    bench.put("identity.pem", bench.acme.issue("sensor9"))


def key_for_everybody(bench: Bench) -> None:
    (bench.identity / "identity.pem").chmod(0o644)


def no_list(bench: Bench) -> None:
    (bench.identity / "revoked.pem").unlink()


def no_folder(bench: Bench) -> None:
    bench.identity.rename(bench.identity.with_name("old"))


WRONG = {
    expired: "expired at",
    not_yet_valid: "not valid before",
    revoked: "revoked; expected another certificate",
    of_another_fleet: "not issued by the authority in fleet.pem",
    self_signed: "certificate.pem: ",
    of_another_name: "the identity of sensor9; expected ",
    key_of_another: "not the key of certificate.pem",
    key_for_everybody: "mode 0644, so others can use the key; expected 0600",
    no_list: "revoked.pem: No such file or directory",
    no_folder: "no such folder; expected one of `mqttxt keys issue`",
}


@contextmanager
def nobody_connects() -> Iterator[int]:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        listener.setblocking(False)
        yield listener.getsockname()[1]
        with pytest.raises(BlockingIOError):
            listener.accept()


def start(name: str, folder: Path, identity: Path, url: str, *more: str) -> tuple[int, str]:
    words = ROLES[name].format(url=url, identity=identity, folder=folder).split()
    program = sensor.cli.app if words[0] == "sensor" else app
    done = CliRunner().invoke(program, [*(words[1:] if words[0] == "sensor" else words), *more])
    if isinstance(done.exception, ConfigurationError):  # `sensor`'s own main turns it into the line
        return done.exception.exit_code, f"mqttxt: {done.exception}\n"
    return done.exit_code, done.output


@pytest.mark.parametrize("name", ROLES)
@pytest.mark.parametrize("spoil", WRONG, ids=lambda spoil: spoil.__name__)
def test_a_wrong_identity_is_one_line(name: str, spoil: Callable[[Bench], None], tmp_path: Path) -> None:
    bench = Bench(tmp_path, name)
    spoil(bench)
    with nobody_connects() as port:
        code, said = start(name, tmp_path, bench.identity, f"mqtts://localhost:{port}")
        assert code == 2, said
        assert WRONG[spoil] in said
        assert said.count("\n") == 1
        assert said.startswith("mqttxt: ")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", [name for name in ROLES if not name.startswith("broker-")])
def test_an_identity_never_goes_unencrypted(name: str, tmp_path: Path) -> None:
    bench = Bench(tmp_path, name)
    with nobody_connects() as port:
        code, said = start(name, tmp_path, bench.identity, f"mqtt://127.0.0.1:{port}")
        assert (code, said.count("\n")) == (2, 1), said
        assert "not encrypted; expected mqtts:// beside --identity" in said
        code, said = start(name, tmp_path, bench.identity, f"mqtts://127.0.0.1:{port}", "--insecure")
        assert (code, said) == (2, "mqttxt: --insecure: expected none beside --identity\n")


@pytest.mark.parametrize(
    ("url", "insecure", "is_allowed"),
    [
        ("mqtt://127.0.0.1", False, True),
        ("mqtt://127.9.9.9:1884", False, True),
        ("mqtt://[::1]", False, True),
        ("mqtt://localhost", False, True),
        ("mqtt://localhost.example", False, False),
        ("mqtt://0.0.0.0", False, False),
        ("mqtt://10.0.0.1", False, False),
        ("mqtt://cloud.example", False, False),
        ("mqtt://cloud.example", True, True),
        ("mqtts://cloud.example", False, True),
    ],
)
def test_unencrypted_means_loopback_or_insecure(url: str, insecure: bool, is_allowed: bool) -> None:
    address = BrokerAddress.parse(url)
    if is_allowed:
        assert Transport(None, insecure).check(address, "--cloud") == address
    else:
        with pytest.raises(ConfigurationError, match="not encrypted; expected mqtts:// with `identity`, or `ins"):
            Transport(None, insecure).check(address, "--cloud")


def test_datagrams_with_an_identity_are_for_a_fleet_that_signs(tmp_path: Path) -> None:
    acme = Authority.create(tmp_path / "acme", "acme")
    transport = Transport.of(acme.issue("drone1"), False, "drone1")
    address = BrokerAddress.parse("mqtt-sn://fog.example", datagrams=True)
    assert transport.check(address, "--broker", signed=True) == address
    with pytest.raises(ConfigurationError, match="not encrypted; expected `signed` beside `identity`"):
        transport.check(address, "--broker")


def test_a_fog_that_brings_drones_by_air_may_at_its_broker_what_these_may() -> None:
    fog, drone = NodeName.parse("fog1"), NodeName.parse("drone3")

    def of(place: Place, node: NodeName) -> dict[str, tuple[bool, bool]]:
        return {each.filter: (each.publish, each.hear) for each in entries(place, node, Rights(), [fog])}

    own, by_air = of(Place("fog", 1), fog), of(Place("fog", 1, air=True), fog)
    carried = {name.replace("drone3", "+"): may for name, may in of(Place("fog", 1), drone).items()}
    assert not own["+/state/+"][0]
    for name, (publish, hear) in carried.items():
        assert by_air[name][0] >= publish
        assert by_air[name][1] >= hear
    assert of(Place("fog", 1, air=True), drone) == of(Place("fog", 1), drone)


async def test_a_station_of_the_api_has_the_name_of_its_identity(tmp_path: Path) -> None:
    acme = Authority.create(tmp_path / "acme", "acme")
    ops, drone = acme.issue("gs-ops", OPS), acme.issue("drone1")
    assert GroundStation("mqtts://localhost", identity=ops).name == "ops"
    assert GroundStation("mqtts://localhost", identity=str(ops), name="ops").name == "ops"
    for options, said in (
        ({"identity": drone}, "the identity of drone1; expected a station's"),
        ({"identity": ops, "name": "other"}, "the identity of gs-ops; expected that of gs-other"),
        ({"identity": ops, "insecure": True}, "`insecure`: expected none beside `identity`"),
    ):
        with pytest.raises(ConfigurationError, match=said):
            GroundStation("mqtts://localhost", **options)  # type: ignore[arg-type]
    with pytest.raises(ConfigurationError, match="not encrypted"):
        GroundStation("mqtt://localhost", identity=ops)


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda acme: acme.folder.joinpath("broker-fog1").rename(acme.folder / "x"), "broker-fog1: no such folder"),
        (lambda acme: acme.revoke("broker-fog1"), "broker-fog1: revoked"),
    ],
)
def test_an_activator_needs_an_identity_for_its_broker(
    spoil: Callable[[Authority], object], said: str, tmp_path: Path
) -> None:
    bench = Bench(tmp_path, "fog1")
    spoil(bench.acme)
    with nobody_connects() as port:
        code, output = start("fog1", tmp_path, bench.identity, f"mqtts://localhost:{port}")
    assert (code, output.count("\n")) == (2, 1), output
    assert said in output


@pytest.mark.parametrize("name", ROLES)
def test_a_clock_at_1970_starts(name: str, tmp_path: Path) -> None:
    bench = Bench(tmp_path, name)
    assert Identity.load(bench.identity, system=lambda: 0.0).wrong is None
    assert not {"time", "newest.pem"} & set(os.listdir(bench.identity))
