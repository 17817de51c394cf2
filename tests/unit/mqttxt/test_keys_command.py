"""`mqttxt keys` and `mqttxt broker` as a person types them."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from mqttxt.errors import PayloadError
from mqttxt.security.authority import hosts_of
from mqttxt.security.certificate import Certificate
from mqttxt.security.identity import Identity, read_certificate
from mqttxt.security.rights import Rights
from mqttxt.security.seal import Seal
from mqttxt.security.signed_by_authority import BACKDATED
from tests.unit.mqttxt.typed import refused, typed

THREE_COMMANDS = ("keys", "init", "acme", "--fogs", "1", "--drones", "1-2", "--station", "ops")


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("MQTTXT_FLEET", raising=False)
    return tmp_path


@pytest.fixture(scope="module")
def unchanged_fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a fleet, for tests that see to it that nothing in it changes."""
    folder = tmp_path_factory.mktemp("fleet")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        well_typed(*THREE_COMMANDS)
    return folder


def well_typed(*words: str) -> str:
    done = typed(*words)
    assert done.exit_code == 0, done.output
    return done.output


def test_a_small_fleet_in_one_command(here: Path) -> None:
    said = well_typed(*THREE_COMMANDS)
    assert "keep acme/authority.pem offline" in said
    identities = sorted(path.parent.name for path in here.glob("acme/*/identity.pem"))
    assert identities == ["broker-cloud", "broker-fog1", "drone1", "drone2", "fog1", "gs-ops"]
    for name in identities:
        assert well_typed("keys", "check", f"acme/{name}").endswith("of fleet acme: good\n")
    every = Rights(None, take_over=True, observe=True, upload_plan=True, set_parameters=True)
    assert Identity.load(here / "acme/gs-ops").certificate.rights == every


def test_issue_one_by_one(here: Path) -> None:
    well_typed("keys", "init", "acme")
    assert well_typed("keys", "issue", "drone", "1-2,9") == "acme/drone1\nacme/drone2\nacme/drone9\n"
    assert well_typed("keys", "issue", "fog", "1", "--dns", "fog1.example") == "acme/broker-fog1\nacme/fog1\n"
    assert well_typed("keys", "issue", "broker", "cloud", "--address", "10.0.0.1") == "acme/broker-cloud\n"
    well_typed("keys", "issue", "station", "ops", "--may", "command", "--drones", "1-2", "--days", "90")
    assert "command/1-2" in well_typed("keys", "show", "acme/gs-ops")
    well_typed(*["keys", "issue", "station", "surveyor", "--may", "command", "--may", "upload-plan", "--drones", "1"])
    surveyor = Identity.load(here / "acme/gs-surveyor").certificate.rights
    assert surveyor == Rights(frozenset({1}), upload_plan=True)
    assert len(well_typed("keys", "show").splitlines()) == 8


def test_revoke_and_renew(here: Path) -> None:
    well_typed(*THREE_COMMANDS)
    well_typed("keys", "renew", "drone1")
    assert "drone1: 1 revoked; list 2: acme/revoked.pem" in well_typed("keys", "revoke", "drone1", "--old")
    well_typed("keys", "check", "acme/drone1")
    assert "drone1: 1 revoked; list 3" in well_typed("keys", "revoke", "drone1")
    assert "drone1: revoked" in typed("keys", "check", "acme/drone1").output
    assert well_typed("keys", "show").count("revoked") == 2


@pytest.mark.long
def test_other_rights_by_revoke_and_issue(here: Path) -> None:
    """As the guide has it: the certificate of before is refused from then on, the new one has the new rights."""
    well_typed(*THREE_COMMANDS)
    shutil.copytree("acme/gs-ops", "of_before")
    issue = ("keys", "issue", "station", "ops", "--may", "command", "--drones", "2")
    assert "for other rights `mqttxt keys revoke gs-ops` before" in refused(*issue)
    drone, old = Seal(Identity.load(here / "acme/drone1")), Seal(Identity.load(here / "of_before"))
    drone.open_of_station("drone1/commands", old.sign("drone1/commands", b"x", with_certificate=True))

    well_typed("keys", "revoke", "gs-ops")
    assert "gs-ops: revoked; expected `mqttxt keys issue`" in refused("keys", "renew", "gs-ops")
    assert well_typed(*issue) == "acme/gs-ops\n"

    drone.identity.fleet.take(drone.identity.fleet.in_folder())
    with pytest.raises(PayloadError, match="gs-ops: revoked"):
        drone.open_of_station("drone1/commands", old.sign("drone1/commands", b"x"))
    new = Seal(Identity.load(here / "acme/gs-ops"))
    heard = drone.open_of_station("drone1/commands", new.sign("drone1/commands", b"x", with_certificate=True))
    assert heard.certificate.rights == Rights(frozenset({2}))
    members = Certificate.all_from_pem((here / "acme/broker-fog1/members.pem").read_bytes(), "members")
    assert [each for each in members if each.name == "gs-ops"] == [new.certificate]
    assert typed("keys", "check", "of_before").exit_code == 0, "a copy elsewhere has the list of before"
    assert typed("keys", "check", "acme/gs-ops~").exit_code == 2


@pytest.mark.long
def test_a_fog_that_was_revoked_gets_another_identity_beside_its_broker(here: Path) -> None:
    well_typed(*THREE_COMMANDS)
    well_typed("keys", "revoke", "fog1")
    assert well_typed("keys", "issue", "fog", "1") == "acme/fog1\n"
    well_typed("keys", "revoke", "fog1")
    well_typed("keys", "revoke", "broker-fog1")
    assert well_typed("keys", "issue", "fog", "1", "--dns", "fog1.example") == "acme/broker-fog1\nacme/fog1\n"
    for name in ("fog1", "broker-fog1"):
        well_typed("keys", "check", f"acme/{name}")


@pytest.mark.long
def test_check_has_a_line_for_each_thing_that_is_wrong(here: Path) -> None:
    well_typed(*THREE_COMMANDS)
    folder = here / "acme/broker-fog1"
    (folder / "identity.pem").write_bytes((here / "acme/fog1/identity.pem").read_bytes())
    (folder / "revoked.pem").write_bytes(b"none")
    (folder / "members.pem").unlink()
    done = typed("keys", "check", "acme/broker-fog1")
    assert done.exit_code == 2
    assert [line.partition(": ")[2].partition(": ")[0] for line in done.output.splitlines()] == [
        "acme/broker-fog1/revoked.pem",
        "acme/broker-fog1/identity.pem",
    ]
    (folder / "revoked.pem").write_bytes((here / "acme/revoked.pem").read_bytes())
    assert "not the key of certificate.pem (broker-fog1)" in typed("keys", "check", "acme/broker-fog1").output
    well_typed("keys", "renew", "broker-fog1")
    (folder / "members.pem").unlink()
    assert "members.pem: No such file" in typed("keys", "check", "acme/broker-fog1").output


@pytest.mark.long
def test_a_broker_is_renewed_for_another_name(here: Path) -> None:
    """As a fog's second broker, which answers at a name of its own, or one that has moved."""
    well_typed(*THREE_COMMANDS)

    def hosts() -> set[str]:
        return set(hosts_of(read_certificate(here / "acme/broker-fog1/certificate.pem")))

    before = hosts()
    well_typed("keys", "renew", "broker-fog1", "--dns", "fog1.lte.example", "--dns", "fog1.sat.example")
    both = {"fog1.lte.example", "fog1.sat.example"}
    assert hosts() == both | before
    well_typed("keys", "renew", "broker-fog1")
    assert hosts() == both | before
    well_typed("keys", "renew", "broker-fog1", "--address", "10.0.0.1")
    assert hosts() == {"10.0.0.1"} | before
    said = refused("keys", "renew", "fog1", "--dns", "x.example")
    assert "fog1: expected --dns and --address for brokers alone" in said


def test_the_configuration_names_the_identitys_files(here: Path) -> None:
    well_typed(*THREE_COMMANDS)
    path = well_typed(
        "broker", "cloud", "--identity", "acme/broker-cloud", "--out", "out", "--listen", "127.0.0.1:8890"
    )
    text = Path(path.strip()).read_text()
    for line in (
        "listener 8890 127.0.0.1",
        "allow_anonymous false",
        "require_certificate true",
        "use_identity_as_username true",
        "tls_version tlsv1.3",
        f"crlfile {here}/acme/broker-cloud/revoked.pem",
        f"acl_file {here}/out/access.acl",
    ):
        assert line in text.splitlines()
    access = (here / "out/access.acl").read_text()
    assert "user fog1\n" in access
    assert "user drone1\n" not in access
    well_typed("keys", "revoke", "gs-ops")
    well_typed("broker", "cloud", "--identity", "acme/broker-cloud", "--out", "out")
    assert "user gs-ops\n" in access
    assert "user gs-ops\n" not in (here / "out/access.acl").read_text()


def test_a_fog_that_shares_the_clouds_broker_has_its_own_side_of_it(here: Path) -> None:
    well_typed(*THREE_COMMANDS)
    broker = ("broker", "cloud", "--identity", "acme/broker-cloud", "--out", "out", "--prefix", "x")
    well_typed(*broker)
    assert "/local/" not in (here / "out/access.acl").read_text()
    well_typed(*broker, "--fogs", "1")
    entries = {
        (lines := each.splitlines())[0].removeprefix("user "): lines[1:]
        for each in (here / "out/access.acl").read_text().split("\n\n")[1:]
    }
    assert "topic write x/fog1/local/+/commands" in entries["fog1"]
    assert "topic read x/fog1/local/drone2/commands" in entries["drone2"]
    assert not [line for line in entries["drone2"] if "drone1" in line]
    assert "topic deny x/fog1/local/#" in entries["gs-ops"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("keys init a/b", "fleet name 'a/b': expected 1 to 64"),
        ("keys init acme", "acme: File exists; expected a new folder"),
        ("keys init other --drones 251", "--drones: '251': expected numbers from 1 to 250"),
        ("keys init other --fogs 0", "--fogs: '0': expected numbers from 1 to "),
        ("keys init other --drones 1,3-2", "--drones: '1,3-2': 3-2 is reversed; expected 2-3"),
        ("keys issue drone 3-2", "drone: '3-2': 3-2 is reversed; expected 2-3"),
        ("keys issue drone x", "drone: 'x': expected numbers"),
        ("keys issue drone 1", "acme/drone1: is there; expected a node that has no identity yet"),
        ("keys issue drone 3 --may command", "drone: expected --may and --drones for stations alone"),
        ("keys issue drone 3 --dns a.example", "drone 3: expected --dns and --address for fogs and brokers alone"),
        ("keys issue drone 3 --days 0", "days 0: expected more than 0"),
        ("keys issue drone 3 --days nan", "days nan: expected"),
        ("keys issue station x", "station: expected --may command, --may take-over or --may observe"),
        ("keys issue station x --may command", "--may command: expected --drones beside it"),
        ("keys issue station x --may observe --drones 1", "--drones 1: expected --may command beside it"),
        ("keys issue station x --may command --drones 0", "--drones: '0': expected numbers from 1 to 250"),
        ("keys issue station x --may upload-plan", "--may upload-plan: expected --may command beside it"),
        ("keys issue station a/b --may observe", "node name 'gs-a/b': expected"),
        ("keys issue broker moon", "node name 'moon': expected"),
        ("keys issue broker sensor1", "broker-sensor1: expected broker-cloud, broker-fogX or broker-droneY"),
        ("keys revoke drone9", "drone9: no certificate in acme/issued"),
        ("keys renew drone9", "acme/drone9: no such folder"),
        ("keys revoke drone1 --fleet nowhere", "nowhere: no authority.pem; expected a folder of `mqttxt keys init`"),
        ("keys show nowhere", "nowhere: No such file or directory"),
        ("keys show acme/revoked.pem", "acme/revoked.pem: not a certificate in PEM; expected a certificate"),
        ("keys check nowhere", "identity nowhere: no such folder"),
        ("broker fog --identity acme/drone1 --out out", "acme/drone1: the identity of drone1; expected a broker's"),
        ("broker fog --identity acme/broker-cloud --out out", "expected the identity of a fog broker"),
        (
            "broker cloud --identity acme/broker-cloud --out acme/fleet.pem",
            "File exists; expected to be able to write it",
        ),
        ("broker cloud --identity acme/broker-cloud --out out --listen x", "--listen 'x': expected HOST:PORT"),
        ("broker fog --identity acme/broker-fog1 --out out --prefix a", "--prefix 'a': expected at the cloud broker"),
        ("broker cloud --identity acme/broker-cloud --out out --prefix +", "topic prefix '+'"),
        ("broker cloud --identity acme/broker-cloud --out out --fogs x", "--fogs: 'x': expected numbers from 1"),
        ("broker cloud --identity acme/broker-cloud --out out --fogs 1-2", "--fogs '1-2': fog 2 is none of the fleet"),
        ("broker fog --identity acme/broker-fog1 --out out --fogs 1", "--fogs '1': expected at the cloud broker"),
    ],
)
def test_bad_input_is_one_line(unchanged_fleet: Path, words: str, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(unchanged_fleet)
    monkeypatch.delenv("MQTTXT_FLEET", raising=False)
    before = sorted(os.walk(unchanged_fleet))
    assert said in refused(*words.split())
    assert sorted(os.walk(unchanged_fleet)) == before


def test_a_fleet_that_cannot_be_written_is_one_line(here: Path) -> None:
    well_typed("keys", "init", "acme")
    (here / "acme/.drone1.new").write_text("in the way")
    said = refused("keys", "issue", "drone", "1")
    assert "acme/.drone1.new: File exists; expected to be able to write it" in said


def test_an_identity_that_was_half_made_is_made_anew(here: Path) -> None:
    well_typed("keys", "init", "acme")
    (here / "acme/.drone1.new").mkdir()
    (here / "acme/.drone1.new/certificate.pem").write_text("half")
    well_typed("keys", "issue", "fog", "1")
    assert well_typed("keys", "issue", "drone", "1") == "acme/drone1\n"
    well_typed("keys", "check", "acme/drone1")


def test_two_fleets_need_a_choice(here: Path) -> None:
    well_typed("keys", "init", "one")
    well_typed("keys", "init", "two")
    assert "--fleet: 2 fleets in this folder" in typed("keys", "issue", "drone", "1").output
    assert well_typed("keys", "issue", "drone", "1", "--fleet", "two") == "two/drone1\n"


def test_of_several_names_all_are_issued_or_none(here: Path) -> None:
    well_typed("keys", "init", "acme")
    well_typed("keys", "issue", "drone", "6")
    well_typed("keys", "issue", "fog", "2")
    assert "acme/drone6: is there; expected" in refused("keys", "issue", "drone", "5-7")
    assert "acme/fog2: is there; expected" in refused("keys", "issue", "fog", "1-2")
    assert sorted(path.name for path in (here / "acme").glob("[!.]*") if path.is_dir()) == [
        "broker-fog2", "drone6", "fog2", "issued",
    ]  # fmt: skip


def test_a_certificate_that_would_be_over_is_not_issued(here: Path) -> None:
    well_typed("keys", "init", "acme")
    assert "days 1e-09: it would end at " in refused("keys", "issue", "drone", "3", "--days", "1e-9")
    assert not (here / "acme/drone3").exists()
    well_typed("keys", "issue", "drone", "3", "--days", "0.001")
    assert well_typed("keys", "check", "acme/drone3").endswith("good\n")


def test_days_count_from_now_also_after_renewals(here: Path) -> None:
    well_typed("keys", "init", "acme")
    well_typed("keys", "issue", "drone", "3", "--days", "10")
    for _ in range(3):
        found = Identity.load(here / "acme/drone3").certificate
        assert found.not_after_s - found.not_before_s == 10 * 86_400 + BACKDATED.total_seconds()
        well_typed("keys", "renew", "drone3")


@pytest.mark.parametrize(
    ("option", "host", "says"),
    [
        ("--address", "nonsense", "--address 'nonsense': expected an IP address; a name is --dns"),
        ("--address", "10.0.0.256", "--address '10.0.0.256': expected an IP address; a name is --dns"),
        ("--dns", "10.0.0.256", "host '10.0.0.256': expected a DNS name or an address"),
    ],
)
def test_a_host_that_nobody_can_reach_is_one_line(here: Path, option: str, host: str, says: str) -> None:
    well_typed("keys", "init", "acme")
    assert refused("keys", "issue", "broker", "cloud", option, host) == says
    well_typed("keys", "issue", "broker", "cloud")
    assert refused("keys", "renew", "broker-cloud", option, host) == says


@pytest.mark.parametrize("host", ["0.0.0.0\nallow_anonymous true\n#", "x y", "x\ty", "x\u2028y", "a#b", "a/b", "a@b"])
@pytest.mark.parametrize("server", ["mosquitto", "rabbitmq"])
def test_a_host_adds_no_line_to_a_brokers_configuration(unchanged_fleet: Path, host: str, server: str) -> None:
    out, listen = unchanged_fleet / "out", f"{host}:8883"
    broker = ("broker", "cloud", "--identity", unchanged_fleet / "acme/broker-cloud", "--server", server)
    said = refused(*broker, "--out", out, "--listen", listen)
    assert said == f"--listen {listen!r}: expected HOST:PORT, with a port from 1 to 65535"
    assert not out.exists()


def test_a_folder_adds_no_line_to_a_brokers_configuration(unchanged_fleet: Path) -> None:
    out = unchanged_fleet / "a\nallow_anonymous true"
    said = refused("broker", "cloud", "--identity", unchanged_fleet / "acme/broker-cloud", "--out", out)
    assert said == f"{str(out / 'access.acl')!r}: mosquitto.conf names it; expected printable characters"
    assert not out.exists()
