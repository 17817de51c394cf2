"""Identities, certificates and the fleet's authority (docs/protocol.md, section 11)."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric import ec
from hypothesis import given
from hypothesis import strategies as st

from mqttxt.errors import ConfigurationError
from mqttxt.protocol.commands import Mavlink
from mqttxt.security import files
from mqttxt.security.authority import MEMBERS_FILE, Authority, hosts_of
from mqttxt.security.certificate import Certificate
from mqttxt.security.fleet import Fleet
from mqttxt.security.identity import Identity, read_certificate
from mqttxt.security.names import Kind, NodeName
from mqttxt.security.rights import Rights, command_right, parse_numbers, write_numbers
from mqttxt.security.signed_by_authority import BACKDATED
from mqttxt.security.trusted_time import TrustedTime
from tests.simulation.fleet_of_keys import CLIENT, SERVER, certificate_der

DAY_S = 86_400.0
OPS = Rights(frozenset({1, 2, 3, 7}), take_over=True, observe=True)


def now_s() -> float:
    return datetime.now(UTC).timestamp()


@pytest.fixture
def drone3(acme: Authority) -> Path:
    """The folder of a drone's identity."""
    return acme.issue("drone3")


# Names and rights.


@pytest.mark.parametrize(
    ("text", "kind", "number", "label"),
    [
        ("fog1", Kind.FOG, 1, ""),
        ("drone250", Kind.DRONE, 250, ""),
        ("sensor999999999", Kind.SENSOR, 999_999_999, ""),
        ("gs-" + "o" * 61, Kind.STATION, 0, "o" * 61),
        ("broker-cloud", Kind.BROKER, 0, "cloud"),
    ],
)
def test_a_name_is_read_and_written(text: str, kind: Kind, number: int, label: str) -> None:
    name = NodeName.parse(text)
    assert (name.kind, name.number, name.label, str(name)) == (kind, number, label, text)


@pytest.mark.parametrize(
    "text", ["", "drone0", "drone251", "drone03", "drone-1", "gs-", "gs-" + "o" * 62, "gs-a/b", "fog1 ", "DRONE1", "+"]
)
def test_another_name_is_refused(text: str) -> None:
    with pytest.raises(ConfigurationError, match="expected fogX"):
        NodeName.parse(text)


@given(st.builds(Rights, st.none() | st.frozensets(st.integers(1, 250)), st.booleans(), st.booleans(), st.booleans()))
def test_rights_survive_their_certificate(rights: Rights) -> None:
    assert Rights.of_uris(rights.uris()) == rights


@pytest.mark.parametrize("number", [180, 245])
def test_a_mav_cmd_that_sets_parameters_needs_the_right_to(number: int) -> None:
    """A drone may allow these MAV_CMDs (R5.17): that gives no station a right that its certificate lacks."""
    command = Mavlink(number, (None,) * 7)
    assert Rights(None, upload_plan=True).missing(command, 1) == "mqttxt:may/set-parameters"
    assert Rights(None, set_parameters=True).missing(command, 1) is None
    assert Rights(None).missing(Mavlink(178, (None,) * 7), 1) is None


def test_rights_in_their_shortest_form() -> None:
    assert OPS.uris() == ("mqttxt:may/command/1-3,7", "mqttxt:may/take-over", "mqttxt:may/observe")
    assert Rights(None).uris() == ("mqttxt:may/command/*",)
    assert Rights().uris() == ()
    assert (OPS.may_command(3), OPS.may_command(4), Rights(None).may_command(250)) == (True, False, True)
    assert command_right(3) == "mqttxt:may/command/3"


@given(st.frozensets(st.integers(1, 250), min_size=1))
def test_numbers_survive_their_text(numbers: frozenset[int]) -> None:
    assert parse_numbers(write_numbers(numbers), 250, "drones") == numbers


@pytest.mark.parametrize("text", ["", "0", "251", "3-1", "1-", "-1", "1,,2", "1-2-3", "a", "１", "1 ,2", "9" * 5000])
def test_numbers_that_are_none(text: str) -> None:
    with pytest.raises(ConfigurationError, match=r"expected numbers from 1 to 250, as 1-3,7"):
        parse_numbers(text, 250, "drones")


@pytest.mark.parametrize(
    "uris",
    [
        ("mqttxt:may/fly",),
        ("mqttxt:may/observe", "mqttxt:may/observe"),
        ("mqttxt:may/command/1", "mqttxt:may/command/2"),
        ("mqttxt:may/command/",),
        ("mqttxt:may/command/1-251",),
    ],
)
def test_unknown_rights_are_refused_never_guessed(uris: tuple[str, ...]) -> None:
    with pytest.raises(ConfigurationError):
        Rights.of_uris(uris)


# Certificates.


def test_a_certificate_says_who_and_what(acme: Authority) -> None:
    identity = Identity.load(acme.issue("gs-ops", OPS, 90))
    found = identity.certificate
    assert (found.name, found.fleet, found.rights) == ("gs-ops", "acme", OPS)
    assert found.not_after_s - found.not_before_s == BACKDATED.total_seconds() + 90 * DAY_S
    assert found.not_before_s <= now_s() - 299
    assert Certificate.from_der(found.der) == found
    found.public_key.verify(identity.sign(b"land"), b"land")
    with pytest.raises(InvalidSignature):
        found.public_key.verify(identity.sign(b"land"), b"arm")


@pytest.mark.parametrize(
    ("der", "said"),
    [
        (certificate_der("drone251"), "node name 'drone251'"),
        (certificate_der("drone3", names=2), "2 common names; expected one"),
        (certificate_der(uris=()), "0 fleets; expected one"),
        (certificate_der(uris=("mqttxt:fleet/a", "mqttxt:fleet/b")), "2 fleets; expected one"),
        (certificate_der(uris=("mqttxt:fleet/\x1b[2J",)), "expected 1 to 64 characters"),
        (certificate_der(uris=("mqttxt:fleet/acme", "mqttxt:may/fly")), "right 'mqttxt:may/fly'"),
        (
            certificate_der(uris=("mqttxt:fleet/acme", "mqttxt:may/command/*")),
            "rights of drone3",
        ),
        (certificate_der(usage=SERVER), "expected clientAuth alone"),
        (certificate_der(usage=None), "expected clientAuth alone"),
        (certificate_der("broker-cloud", usage=CLIENT), "expected serverAuth alone"),
        (certificate_der(is_authority=True), "expected basic constraints CA:FALSE"),
        (certificate_der(key=ec.generate_private_key(ec.SECP256R1())), "expected an Ed25519 key"),
        (certificate_der().replace(b"\x0c\x06drone3", b"\x03\x06drone3"), "BitString"),
        (b"", "not an X.509 certificate"),
        (b"\x30\x80", "not an X.509 certificate"),
    ],
)
def test_a_certificate_that_is_none(der: bytes, said: str) -> None:
    with pytest.raises(ConfigurationError) as found:
        Certificate.from_der(der, "birth of drone3")
    assert str(found.value).startswith("birth of drone3: ")
    assert said in str(found.value)
    assert "\n" not in str(found.value)


@given(at=st.integers(0, 400), value=st.integers(0, 255), cut=st.integers(0, 50))
def test_no_bytes_do_more_than_be_refused(at: int, value: int, cut: int) -> None:
    der = bytearray(_ANY)
    der[at % len(der)] = value
    try:
        Certificate.from_der(bytes(der[: len(der) - cut]))
    except ConfigurationError as error:
        assert "\n" not in str(error)  # noqa: PT017 - most bytes leave a certificate as good as it was


_ANY = certificate_der("gs-ops", ("mqttxt:fleet/acme", "mqttxt:may/command/1-3"))


# The fleet.


def revoke_another(acme: Authority) -> None:
    """Make the fleet's list newer, by a station that is revoked."""
    acme.issue("gs-a")
    acme.revoke("gs-a")


def test_a_fleet_knows_its_own(acme: Authority, tmp_path: Path) -> None:
    theirs = Authority.create(tmp_path / "theirs", "acme")
    ours = Identity.load(acme.issue("drone3", days=10)).certificate
    verify = acme.fleet.verify
    assert verify(ours, now_s()) is None
    assert verify(ours, ours.not_before_s - 1) == "not_yet_valid"
    assert verify(ours, ours.not_before_s) is None
    assert verify(ours, ours.not_after_s) is None
    assert verify(ours, ours.not_after_s + 1) == "expired"
    assert verify(Identity.load(theirs.issue("drone3")).certificate, now_s()) == "other_fleet"
    assert verify(Certificate.from_der(certificate_der()), now_s()) == "other_fleet"
    assert acme.revoke("drone3") == 1
    assert verify(ours, now_s()) == "revoked"


def test_a_certificate_lasts_no_longer_than_its_authority(acme: Authority) -> None:
    found = Identity.load(acme.issue("drone3", days=10_957)).certificate
    assert found.not_after_s == acme.fleet.not_after_s


@pytest.mark.long
def test_the_highest_revocation_list_counts_and_is_kept(acme: Authority, drone3: Path, tmp_path: Path) -> None:
    drone = Identity.load(drone3)
    lists = [acme.fleet.revoked.der]
    for name in ("gs-a", "gs-b"):
        acme.issue(name)
        acme.revoke(name)
        lists.append(acme.fleet.revoked.der)
    taken = [drone.fleet.take(drone.fleet.read(lists[at])) for at in (2, 1, 0, 2)]
    assert taken == [True, False, False, False]
    assert drone.fleet.revoked.number == 3
    drone.fleet.keep()
    assert Fleet.load(drone3).revoked == drone.fleet.revoked
    theirs = Authority.create(tmp_path / "theirs", "acme")
    for _ in range(5):
        theirs.issue("gs-a")
        theirs.revoke("gs-a")
    for wrong in (theirs.fleet.revoked.der, b"", b"-----BEGIN X509 CRL-----", lists[2][:-1]):
        with pytest.raises(ConfigurationError, match=r"^revocation list: "):
            drone.fleet.read(wrong)
    assert drone.fleet.revoked.number == 3


def test_an_older_list_that_was_put_into_the_folder_counts_after_no_restart(acme: Authority, drone3: Path) -> None:
    older = (drone3 / "revoked.pem").read_bytes()
    revoke_another(acme)
    drone = Identity.load(drone3)
    (drone3 / "revoked.pem").write_bytes(older)
    assert not drone.fleet.take(drone.fleet.in_folder())
    drone.fleet.keep()
    assert drone.fleet.revoked.number == 2
    assert (drone3 / "revoked.pem").read_bytes() == drone.fleet.revoked.pem()


def test_an_older_list_that_was_put_back_while_the_node_was_stopped_does_not_count(
    acme: Authority, drone3: Path
) -> None:
    older = (drone3 / "revoked.pem").read_bytes()
    revoke_another(acme)
    Identity.load(drone3).fleet.keep()
    (drone3 / "revoked.pem").write_bytes(older)
    started = Identity.load(drone3)
    assert started.fleet.revoked.number == 2
    assert started.fleet.verify(next(each for each in acme.issued() if each.name == "gs-a"), now_s()) == "revoked"
    started.fleet.keep()
    assert (drone3 / "revoked.pem").read_bytes() == started.fleet.revoked.pem()


def test_a_newer_list_that_waits_in_the_folder_is_not_written_over(acme: Authority, drone3: Path) -> None:
    """A node writes its list every ten minutes: one that was brought there meanwhile counts from SIGHUP or start on."""
    drone = Identity.load(drone3)
    drone.fleet.keep()
    revoke_another(acme)
    newer = acme.fleet.revoked.pem()
    (drone3 / "revoked.pem").write_bytes(newer)
    drone.fleet.keep()
    assert (drone3 / "revoked.pem").read_bytes() == newer
    assert drone.fleet.take(drone.fleet.in_folder())
    drone.fleet.keep()
    assert (drone3 / "newest.pem").read_bytes() == newer


def test_two_processes_of_an_identity_keep_the_newer_list(acme: Authority) -> None:
    folder = acme.issue("gs-ops")
    behind, ahead = Identity.load(folder), Identity.load(folder)
    revoke_another(acme)
    assert ahead.fleet.take(acme.fleet.revoked)
    for process in (ahead, behind):
        process.fleet.keep()
    assert Identity.load(folder).fleet.revoked.number == 2


def test_a_list_that_is_taken_while_an_older_one_is_kept_is_not_written_over(
    acme: Authority, drone3: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fleet = Identity.load(drone3).fleet
    revoke_another(acme)
    read = files.read

    def read_later(path: Path) -> bytes:
        fleet.take(acme.fleet.revoked)
        return read(path)

    monkeypatch.setattr(files, "read", read_later)
    fleet.keep()
    assert (drone3 / "revoked.pem").read_bytes() == acme.fleet.revoked.pem()


def test_a_spoilt_list_in_the_folder_is_written_anew(drone3: Path) -> None:
    drone = Identity.load(drone3)
    (drone3 / "revoked.pem").write_bytes(b"")
    drone.fleet.keep()
    assert (drone3 / "revoked.pem").read_bytes() == drone.fleet.revoked.pem()


def test_what_two_processes_revoke_at_once_is_all_revoked(acme: Authority) -> None:
    for name in ("gs-a", "gs-b", "drone3"):
        acme.issue(name)
    other = Authority.load(acme.folder)
    acme.revoke("gs-a")
    other.revoke("gs-b")
    found = Fleet.load(acme.folder / "drone3").revoked
    assert found.number == 3
    assert found.serials == {each.serial for each in acme.issued() if each.name != "drone3"}


def test_a_list_that_cannot_be_kept_counts_and_is_kept_later(acme: Authority, drone3: Path) -> None:
    drone = Identity.load(drone3)
    revoke_another(acme)
    moved = drone3.rename(drone3.with_name("elsewhere"))
    assert drone.fleet.take(acme.fleet.revoked)
    with pytest.raises(ConfigurationError, match="expected to be able to write it"):
        drone.fleet.keep()
    moved.rename(drone3)
    drone.fleet.keep()
    assert Fleet.load(drone3).revoked.number == 2


@pytest.mark.parametrize("spoilt", [b"", b"\0" * 500, b"-----BEGIN X509 CRL-----\n", None])
def test_a_node_starts_without_the_list_that_it_kept_and_keeps_it_anew(
    acme: Authority, drone3: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture, spoilt: bytes | None
) -> None:
    """A drone in flight that starts anew must not end by a file that it wrote itself; None is another fleet's list."""
    Identity.load(drone3).fleet.keep()
    theirs = Authority.create(tmp_path / "theirs", "theirs").fleet.revoked.pem()
    (drone3 / "newest.pem").write_bytes(theirs if spoilt is None else spoilt)
    drone = Identity.load(drone3)
    assert drone.fleet.revoked == acme.fleet.revoked
    (line,) = caplog.messages
    assert line.startswith(f"{drone3 / 'newest.pem'}: ")
    drone.fleet.keep()
    assert (drone3 / "newest.pem").read_bytes() == acme.fleet.revoked.pem()


def test_a_kept_list_that_cannot_be_read_is_written_anew(drone3: Path) -> None:
    fleet = Identity.load(drone3).fleet
    fleet.keep()
    (drone3 / "newest.pem").write_bytes(bytes(files.MOST_BYTES + 1))
    fleet.keep()
    assert (drone3 / "newest.pem").read_bytes() == fleet.revoked.pem()


def test_an_authority_that_was_restored_goes_on_from_a_nodes_newest_list(acme: Authority) -> None:
    restored = (acme.folder / "revoked.pem").read_bytes()
    folder = acme.issue("drone3")
    for name in ("gs-a", "gs-b"):
        acme.issue(name)
    acme.revoke("gs-a")
    Identity.load(folder).fleet.keep()
    (acme.folder / "revoked.pem").write_bytes(restored)
    (acme.folder / "revoked.pem").write_bytes((folder / "newest.pem").read_bytes())
    again = Authority.load(acme.folder)
    again.revoke("gs-b")
    assert (again.fleet.revoked.number, len(again.fleet.revoked.serials)) == (3, 2)


# An identity's folder.


GARBAGE = b"-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n"


@pytest.mark.parametrize(
    ("file", "spoil", "said"),
    [
        ("identity.pem", Path.unlink, "No such file or directory"),
        (
            *("identity.pem", lambda path: path.chmod(0o640)),
            "mode 0640, so others can use the key; expected 0600: chmod 600 ",
        ),
        ("identity.pem", lambda path: path.write_bytes(b"\0key"), "not a private key in PEM without a password"),
        ("certificate.pem", lambda path: path.write_bytes(GARBAGE), "not a certificate in PEM"),
        ("certificate.pem", lambda path: path.write_bytes(path.read_bytes() * 2), "2 certificates; expected one"),
        ("revoked.pem", Path.unlink, "No such file or directory"),
        ("revoked.pem", lambda path: path.write_bytes(b""), "not a certificate revocation list"),
        (
            *("fleet.pem", lambda path: shutil.copy(path.with_name("certificate.pem"), path)),
            "not a fleet authority's certificate",
        ),
    ],
)
def test_a_folder_with_something_wrong_is_refused(
    drone3: Path, file: str, spoil: Callable[[Path], object], said: str
) -> None:
    spoil(drone3 / file)
    with pytest.raises(ConfigurationError) as found:
        Identity.load(drone3)
    assert f"{drone3 / file}: {said}" in str(found.value)
    assert "\n" not in str(found.value)


def test_a_certificate_that_is_not_ones_own_is_refused(acme: Authority, drone3: Path) -> None:
    shutil.copy(acme.issue("drone4") / "certificate.pem", drone3)
    with pytest.raises(ConfigurationError, match=r"identity.pem: not the key of certificate.pem \(drone4\)"):
        Identity.load(drone3)


def test_an_identity_of_another_fleet_is_refused(drone3: Path, tmp_path: Path) -> None:
    theirs = Authority.create(tmp_path / "theirs", "acme").issue("drone3")
    shutil.copy(theirs / "fleet.pem", drone3)
    with pytest.raises(ConfigurationError, match=r"revoked.pem: not signed by this fleet's authority"):
        Identity.load(drone3)
    shutil.copy(theirs / "revoked.pem", drone3)
    with pytest.raises(ConfigurationError, match=r"drone3: not issued by the authority in fleet.pem"):
        Identity.load(drone3)


def test_time_decides(acme: Authority) -> None:
    folder = acme.issue("drone3", days=1)
    later = acme.issue("drone4", not_before=datetime.now(UTC) + timedelta(days=1))
    assert Identity.load(folder).name == "drone3"
    with pytest.raises(ConfigurationError, match=r"drone3: expired at .*: `mqttxt keys renew drone3`"):
        Identity.load(folder, system=lambda: now_s() + 2 * DAY_S)
    with pytest.raises(ConfigurationError, match="drone4: not valid before"):
        Identity.load(later)
    acme.revoke("drone3")
    with pytest.raises(ConfigurationError, match="drone3: revoked; expected another certificate"):
        Identity.load(folder)


def test_no_folder() -> None:
    with pytest.raises(ConfigurationError, match="identity /nowhere: no such folder"):
        Identity.load(Path("/nowhere"))


# Time.


def test_a_clock_at_1970_is_that_of_the_revocation_list(acme: Authority) -> None:
    identity = Identity.load(acme.issue("drone3"), system=lambda: 12.0)
    assert identity.time.now_s() == pytest.approx(acme.fleet.revoked.this_update_s, abs=60)
    revoke_another(acme)
    identity.fleet.take(acme.fleet.revoked)
    assert identity.time.now_s() == pytest.approx(acme.fleet.revoked.this_update_s, abs=60)


class Uptime:
    """Seconds since a machine's start."""

    def __init__(self) -> None:
        self.now_s = 40.0

    def __call__(self) -> float:
        return self.now_s


def test_without_a_clock_time_goes_on_and_a_certificate_ends_in_flight(acme: Authority) -> None:
    folder = acme.issue("gs-a", Rights(None), days=1)
    uptime = Uptime()
    clockless = TrustedTime(folder, acme.fleet, system=lambda: 12.0, running=uptime)
    certificate = read_certificate(folder / "certificate.pem")
    assert clockless.verify(certificate) is None
    uptime.now_s += 2 * DAY_S
    assert clockless.verify(certificate) == "expired"
    clockless.keep()
    anew = TrustedTime(folder, acme.fleet, system=lambda: 12.0, running=Uptime())
    assert anew.verify(certificate) == "expired"
    uptime.now_s += DAY_S
    assert clockless.now_s() == pytest.approx(anew.now_s() + DAY_S, abs=2)


def test_without_a_clock_a_certificate_that_is_newer_than_the_list_tells_the_time(acme: Authority) -> None:
    """A fleet is made, and a month later a drone is issued, or renewed, that starts in 1970 each time."""
    later = datetime.now(UTC) + timedelta(days=30)
    drone = acme.issue("drone3", days=400, not_before=later)
    station = acme.issue("gs-a", Rights(None), days=1, not_before=later - timedelta(days=10))
    identity = Identity.load(drone, system=lambda: 12.0)
    assert identity.time.now_s() >= later.timestamp() - 1
    assert identity.time.verify(read_certificate(station / "certificate.pem")) == "expired"
    identity.time.keep()
    assert Identity.load(drone, system=lambda: 12.0).time.now_s() >= later.timestamp() - 1


def test_time_never_goes_back_over_a_start(acme: Authority) -> None:
    folder = acme.issue("drone3", days=1)
    running = TrustedTime(folder, acme.fleet, system=lambda: now_s() + 2 * DAY_S)
    running.keep()
    with pytest.raises(ConfigurationError, match="expired"):
        Identity.load(folder, system=lambda: 12.0)


@pytest.mark.parametrize("content", [b"", bytes(11), b"yesterday", b"9" * 40])
def test_with_a_spoilt_time_the_other_known_times_count(
    acme: Authority, content: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    """A power loss spoils it, and a drone in flight needs its client."""
    later = datetime.now(UTC) + timedelta(days=30)
    folder = acme.issue("drone3", not_before=later)
    (folder / "time").write_bytes(content)
    identity = Identity.load(folder, system=lambda: 12.0)
    assert identity.time.now_s() >= later.timestamp() - 1
    (told,) = caplog.messages
    assert (
        told == f"{folder / 'time'}: {content!r}; expected Unix seconds, or no such file; the other known times count"
    )
    identity.time.keep()
    assert int((folder / "time").read_bytes()) >= later.timestamp() - 1


# The authority.


def test_renewal_has_a_new_key_and_the_old_rights(acme: Authority) -> None:
    folder = acme.issue("gs-ops", OPS, 90)
    old = Identity.load(folder)
    new = Identity.load(acme.renew("gs-ops"))
    assert new.certificate.rights == OPS
    assert new.certificate.public_key != old.certificate.public_key
    assert new.certificate.not_after_s - new.certificate.not_before_s == BACKDATED.total_seconds() + 90 * DAY_S
    assert [acme.fleet.verify(each.certificate, now_s()) for each in (old, new)] == [None, None]
    assert acme.revoke("gs-ops", only_old=True) == 1
    assert [acme.fleet.verify(each.certificate, now_s()) for each in (old, new)] == ["revoked", None]
    assert acme.revoke("gs-ops", only_old=True) == 0


def test_a_renewal_leaves_other_nodes_alone(acme: Authority) -> None:
    others = [acme.issue(name) for name in ("gs-a.before", "gs-a.new")]
    acme.issue("gs-a")
    for _ in range(2):
        acme.renew("gs-a")
    assert [Identity.load(folder).name for folder in others] == ["gs-a.before", "gs-a.new"]
    assert Identity.load(acme.folder / "gs-a~").name == "gs-a"


def test_brokers_know_the_members(acme: Authority) -> None:
    broker = acme.issue("broker-cloud", hosts=["cloud.example", "10.0.0.1"])
    acme.issue("drone3")
    acme.issue("gs-ops", OPS)
    acme.revoke("drone3")
    found = Certificate.all_from_pem((broker / MEMBERS_FILE).read_bytes(), "members")
    assert sorted(each.name for each in found) == ["broker-cloud", "gs-ops"]
    (own,) = (each for each in found if each.name == "broker-cloud")
    assert hosts_of(own) == ("localhost", "cloud.example", "127.0.0.1", "::1", "10.0.0.1")


def test_what_cannot_be_issued(acme: Authority) -> None:
    for call, said in [
        (lambda: acme.issue("drone4", OPS), "rights for drone4: expected a station"),
        (lambda: acme.issue("drone4", hosts=["a.example"]), "hosts for drone4: expected a broker"),
        (lambda: acme.issue("broker-x", hosts=["a b"]), "host 'a b': expected a DNS name or an address"),
        (lambda: acme.issue("broker-x", hosts=["a..b"]), r"host 'a\.\.b': expected"),
        (lambda: acme.issue("drone4", days=1e12), "at most 10957"),
    ]:
        with pytest.raises(ConfigurationError, match=said):
            call()
    assert not (acme.folder / "drone4").exists()


def test_an_authoritys_key_is_private(acme: Authority) -> None:
    assert os.stat(acme.folder / "authority.pem").st_mode & 0o777 == 0o600
    assert os.stat(acme.issue("drone3") / "identity.pem").st_mode & 0o777 == 0o600
    (acme.folder / "authority.pem").chmod(0o644)
    with pytest.raises(ConfigurationError, match="mode 0644"):
        Authority.load(acme.folder)


def test_openssl_reads_what_we_wrote(acme: Authority) -> None:
    """A second implementation has the last word on what X.509 is."""
    for name in ("drone3", "broker-cloud"):
        acme.issue(name)
    every = Rights(OPS.command, take_over=True, observe=True, upload_plan=True, set_parameters=True)
    acme.issue("gs-ops", every)
    acme.revoke("drone3")
    verdicts = {}
    for name, purpose in (("drone3", "sslclient"), ("gs-ops", "sslclient"), ("broker-cloud", "sslserver")):
        verify = ["openssl", "verify", "-x509_strict", "-purpose", purpose, "-crl_check"]
        files = ["-CRLfile", "revoked.pem", "-CAfile", "fleet.pem", f"{name}/certificate.pem"]
        done = subprocess.run([*verify, *files], cwd=acme.folder, capture_output=True, text=True, check=False)
        verdicts[name] = (done.returncode == 0, done.stdout + done.stderr)
    assert verdicts["gs-ops"][0], verdicts["gs-ops"][1]
    assert verdicts["broker-cloud"][0], verdicts["broker-cloud"][1]
    assert "certificate revoked" in verdicts["drone3"][1]
    show = ["openssl", "x509", "-in", "gs-ops/certificate.pem", "-noout", "-ext", "subjectAltName"]
    shown = subprocess.run(show, cwd=acme.folder, capture_output=True, text=True, check=True).stdout
    assert shown.split("\n", 1)[1].strip().split(", ") == [f"URI:{uri}" for uri in ("mqttxt:fleet/acme", *every.uris())]
