"""What a person gets wrong at a role's command is one line that says what was expected, with exit code 2."""

from __future__ import annotations

import asyncio
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, cast

import pytest
import typer
from typer.testing import CliRunner

from mqttxt import BrokerRefused, ConfigurationError, Outcome, SentCommand, StationEnded, Takeoff, Word
from mqttxt.cli.advice import follow, line_of, not_there
from mqttxt.cli.common import errors_as_lines
from mqttxt.cli.gs import PARAMETERS
from mqttxt.cli.main import app
from mqttxt.cli.station import StationOptions
from mqttxt.station import ground_station
from mqttxt.station.heard import Record
from mqttxt.station.outcomes import last_word
from tests.simulation.page_fleet import FakeStation, outcome

if TYPE_CHECKING:
    from mqttxt.station.views import Fog

FORMS = "mqtt://HOST[:PORT] or mqtts://HOST[:PORT], with a port from 1 to 65535"
ADVICE = "not encrypted; expected mqtts:// with --identity, or --insecure"


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ("gs send jump", "command 'jump': expected one of arm, disarm, takeoff, land, goto, hold, return"),
        ("gs send takeoff high", "takeoff altitude_m 'high': expected a number from 0.5 to 10000"),
        ("gs send goto 1 -2 -501 --drone 1", "goto altitude_m '-501': expected a number from -500"),
        ("gs send hold --drnoe 1", "gs send: no such option: --drnoe"),
        ("gs send takeoff nan", "takeoff altitude_m 'nan': expected a number from 0.5 to 10000"),
        ("gs send goto 91 8 9 --drone 1", "goto latitude_deg '91': expected a number from -90 to 90"),
        ("gs send goto -91 -8.25 -5 --drone 1", "goto latitude_deg '-91': expected a number from -90 to 90"),
        ("gs send goto 1 2", "goto: expected LATITUDE_DEG LONGITUDE_DEG ALTITUDE_M, got 1 2"),
        ("gs send goto 1 2 3", "goto: expected --drone NUMBER, or --best: it is for one drone"),
        ("gs send offboard 5 velocity 1 0 0", "offboard: expected --drone NUMBER: it is for one drone"),
        ("gs send --fgo 1 arm", "gs send: no such option: --fgo"),
        ("gs send arm --fgo 1", "gs send: no such option: --fgo"),
        ("gs send arm --cloud mqtt://a..b", "--cloud 'mqtt://a..b': expected mqtt://HOST[:PORT]"),
        ("gs send arm --cloud cloud:1883", "--cloud 'cloud:1883': expected mqtt://HOST[:PORT]"),
        ("gs send arm --cloud mqtt://127.0.0.1:99999", f"--cloud 'mqtt://127.0.0.1:99999': expected {FORMS}"),
        ("gs send arm --cloud mqtt://127.0.0.1:0", f"--cloud 'mqtt://127.0.0.1:0': expected {FORMS}"),
        ("activator --fog 1 --cloud mqtt://127.0.0.1:0", f"--cloud 'mqtt://127.0.0.1:0': expected {FORMS}"),
        ("uav --drone 1 --broker mqtts://127.0.0.1:0", "mqtt-sn://HOST[:PORT], with a port from 1 to 65535"),
        ("gs send arm --qos 2", "--qos 2: expected 0 or 1"),
        ("gs send arm --drone 300", "--drone 300: expected a whole number from 1 to 250"),
        ("gs send arm --cloud mqtt://cloud.example", f"--cloud mqtt://cloud.example:1883: {ADVICE}"),
        ("gs send arm --identity /nowhere", "identity /nowhere: no such folder"),
        ("uav --drone 0 --broker mqtt://x", "--drone 0: expected a whole number from 1 to 250"),
        ("uav --drone 1 --broker mqtt://127.0.0.1 --autopilot usb", "--autopilot 'usb': expected udp:"),
        (
            "uav --drone 1 --broker mqtt://127.0.0.1 --autopilot udp:127.0.0.1",
            "mqttxt: --autopilot 'udp:127.0.0.1': expected udp:HOST:PORT, tcp:HOST:PORT or serial:DEVICE:BAUD",
        ),
        (
            "conformance uav --broker mqtt://x --autopilot udp:127.0.0.1",
            "mqttxt: --autopilot 'udp:127.0.0.1': expected",
        ),
        ("uav --drone 1 --broker mqtt://127.0.0.1 --autopilot serial:/dev/x:0", "expected a baud rate from 1"),
        ("uav --drone 1 --broker mqtt://fog.example", f"--broker mqtt://fog.example:1883: {ADVICE}"),
        (
            "uav --drone 1 --broker mqtt-sn://fog.example",
            "--broker mqtt-sn://fog.example:1883: not encrypted; expected --signed with --identity, or --insecure",
        ),
        (
            "uav --drone 1 --broker mqtt-sn://a:b@127.0.0.1",
            "expected mqtt://HOST[:PORT], mqtts://HOST[:PORT] or mqtt-sn://HOST[:PORT]",
        ),
        (
            "uav --drone 1 --broker mqtt://127.0.0.1 --second-broker mqtt-sn://127.0.0.1",
            "--second-broker 'mqtt-sn://127.0.0.1': expected mqtt://HOST[:PORT] or mqtts://HOST[:PORT]",
        ),
        ("gs send arm --cloud mqtt-sn://127.0.0.1", "expected mqtt://HOST[:PORT] or mqtts://HOST[:PORT]"),
        (
            "activator --fog 1 --cloud mqtt://127.0.0.1 --fog-broker mqtt://127.0.0.1:1 --air-sn 0.0.0.0:1883",
            "--air-sn mqtt-sn://0.0.0.0:1883: not encrypted; expected --signed with --identity, or --insecure",
        ),
        (
            "activator --fog 1 --cloud mqtt://127.0.0.1 --fog-broker mqtt://127.0.0.1:1 --air-sn 1883",
            "--air-sn '1883': expected HOST:PORT",
        ),
        (
            "uav --drone 1 --broker mqtt://127.0.0.1 --second-broker mqtt://127.0.0.1",
            "--second-broker mqtt://127.0.0.1:1883: is another option's address too; expected one of its own",
        ),
        (
            "conformance uav --broker mqtt://127.0.0.1 --second-broker mqtt://fog.example",
            "--second-broker mqtt://fog.example:1883: expected two brokers on this machine",
        ),
        (
            "conformance uav --broker mqtt://127.0.0.1 --second-broker mqtt://127.0.0.1",
            "--second-broker mqtt://127.0.0.1:1883: expected another one than mqtt://127.0.0.1:1883",
        ),
        (
            "conformance activator --broker mqtt://[::1] --fog-broker mqtt://[::1] --second-fog-broker mqtt://[::1]",
            "--second-fog-broker mqtt://[::1]:1883: expected another broker",
        ),
        (
            "uav --drone 1 --broker mqtt://127.0.0.1 --second-broker x",
            "--second-broker 'x': expected mqtt://HOST[:PORT]",
        ),
        (
            "activator --fog 1 --cloud mqtt://127.0.0.1:1 --fog-broker mqtt://[::1] --second-fog-broker mqtt://127.0.0.1:1",
            "--second-fog-broker mqtt://127.0.0.1:1: is another option's address too; expected one of its own",
        ),
        (
            "activator --fog 1 --cloud mqtt://127.0.0.1:1 --fog-broker mqtt://127.0.0.1:2 --audit-required",
            "--audit-required: expected --audit FILE beside it",
        ),
        ("activator --fog 1 --cloud mqtt://127.0.0.1 --listen x", "--listen 'x': expected HOST:PORT"),
        (
            "activator --fog 1 --cloud mqtt://127.0.0.1 --insecure --listen a/b:1",
            "--listen 'a/b:1': expected HOST:PORT",
        ),
        (
            "activator --fog 1 --cloud mqtt://127.0.0.1 --fog-broker mqtt://127.0.0.1:1 --listen 127.0.0.1:2",
            "--listen 127.0.0.1:2: expected none beside --fog-broker",
        ),
        (
            "uav --drone 1 --broker mqtt://127.0.0.1 --sensor-store x",
            "--sensor-store x: expected --sensors or --sensor-broker beside it",
        ),
        (
            "uav --drone 1 --broker mqtt://127.0.0.1 --sensor-store-limit 5",
            "--sensor-store-limit 5: expected --sensors or --sensor-broker beside it",
        ),
        ("gs send land --drone 1 --drone 2", "--drone 1 2: expected one, or none for the whole fog"),
        ("gs send takeoff 1_5", "takeoff altitude_m '1_5': expected a number from 0.5 to 10000"),
        ("gs send takeoff \N{FULLWIDTH DIGIT NINE}", "expected a number from 0.5 to 10000"),
        ("gs send takeoff --dron=2", "gs send: no such option: --dron"),
        ("gs send hold --dron 2", "gs send: no such option: --dron"),
        ("gs page --fog 1 --listen 127.0.0.1:80000", "expected HOST:PORT, with a port from 1 to 65535"),
        (
            "activator --fog 1 --cloud mqtt://127.0.0.1 --listen 127.0.0.1:1 --drones a",
            "--drones: 'a': expected numbers",
        ),
        (
            "activator --fog 1 --cloud mqtt://127.0.0.1 --listen 127.0.0.1:1 --drones 3-1",
            "--drones: '3-1': 3-1 is reversed; expected 1-3",
        ),
        (
            "activator --fog 1 --cloud mqtt://[::1] --fog-broker mqtt://[::1] --fog-root ''",
            "fog root '': expected another root than the cloud side's",
        ),
        (
            "activator --fog 1 --cloud mqtt://127.0.0.1",
            "mqttxt: --listen 0.0.0.0:1883: open to other machines, and not encrypted; "
            "expected --identity FOLDER, 127.0.0.1:1883, or --insecure",
        ),
        (
            "uav --drone 1 --broker mqtt://127.0.0.1 --sensors [::]:8884",
            "--sensors [::]:8884: open to other machines, and not encrypted; expected --identity FOLDER, ",
        ),
        ("conformance uav --broker mqtt://127.0.0.1:1", "--broker mqtt://127.0.0.1:1: no broker answers"),
        ("conformance uav --broker here", "--broker 'here': expected mqtt://HOST[:PORT]"),
        ("conformance uav --broker mqtt://x --drone 0", "--drone 0: expected a whole number from 1 to 250"),
        ("conformance uav --broker mqtt://x --autopilot tcp:x:1", "expected udp:HOST:PORT"),
        ("conformance uav --broker mqtt://x --format xml", "--format 'xml': expected table or json"),
        ("conformance uav --broker mqtt://x --signed", "--signed: expected --fleet FOLDER beside it"),
        ("conformance gs --broker mqtt://x --fleet /", "--broker mqtt://x:1883: not encrypted; expected mqtts://"),
        ("conformance gs --broker mqtts://x --fleet /nowhere", "--fleet /nowhere: no such folder; expected one"),
        ("conformance uav --broker mqtts://x --fleet /tmp", "identity /tmp/fog1: no such folder"),
        (
            "conformance activator --broker mqtts://x --fog-broker mqtts://x --fleet /",
            "--fleet /: expected --signed beside it",
        ),
        (
            "conformance uav --broker mqtt://x --run 'uav {port}'",
            "expected a command line, with {broker}, {drone}",
        ),
        (
            "conformance activator --broker mqtt://x --fog-broker y",
            "--fog-broker 'y': expected mqtt://HOST[:PORT]",
        ),
        ("conformance gs --broker mqtt://x --ttl 61", "--ttl 61: expected more than 0 and at most 60 s"),
        ("gs mavlink --fog 1 --to udp:127.0.0.1:1 --ttl 0", "--ttl 0: expected more than 0 and at most 60 s"),
        ("gs watch --fog 1 --timeout -1", "--timeout -1: expected more than 0 s"),
        (
            "gs plan upload /nope.plan --drone 1",
            "/nope.plan: No such file or directory; expected a file that can be read",
        ),
        (
            "gs watch --fog acme/1 --fog north/1 --cloud acme=mqtt://127.0.0.1:1",
            "--cloud acme=mqtt://127.0.0.1:1: expected a value for fleet north too, as north=VALUE",
        ),
        ("gs page --fog acme/1 --fog 1", "--fog: expected FLEET/NUMBER of each fog, as acme/1"),
        ("gs plan start x.plan --drone 1 --item 0", "--item 0: expected a whole number from 1 to 65535"),
        (
            "gs homeassistant --fog 1 --broker mqtt://127.0.0.1:1 --cloud mqtt://127.0.0.1:1 --discovery a#",
            "--discovery topic prefix 'a#': expected",
        ),
        ("gs params load /nope.params --drone 1", "No such file or directory; expected a file that can be read"),
        ("gs params set 'A B' 1 --drone 1", "set_parameter parameter 'A B': expected ASCII letters"),
        ("gs logs get 1 / --drone 1", "/: is a folder; expected a file in a folder that exists"),
    ],
)
def test_what_a_person_gets_wrong_is_one_line_and_exit_code_2(typed: str, said: str) -> None:
    done = CliRunner().invoke(app, shlex.split(typed))
    assert done.exit_code == 2, done.output
    assert said in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ("gs watch", "gs watch: expected --fog: A fog's number, or FLEET/NUMBER, as acme/1"),
        ("gs watch --fog", "--fog: expected a value behind it"),
        ("gs watch --frog 1", "gs watch: no such option: --frog"),
        ("gs send arm --ttl soon", "gs send: --ttl 'soon': expected a number"),
        ("uav --drone one --broker mqtt://[::1]", "uav: --drone 'one': expected a whole number"),
        ("keys issue plane 1", "keys issue: KIND 'plane': expected one of drone, fog, broker, station, sensor"),
        ("keys check", "keys check: expected FOLDER: An identity's folder."),
        ("fly", "no such command 'fly'; expected one of broker, demo, activator, uav, gs, conformance, keys, audit\n"),
        ("gs wach", "gs: no such command 'wach'; expected one of watch, share-list, send, "),
        ("gs takeoff 10", "gs: no such command 'takeoff'; expected `mqttxt gs send takeoff`"),
    ],
)
def test_what_is_no_command_line_is_one_line_too(typed: str, said: str) -> None:
    done = CliRunner().invoke(app, shlex.split(typed))
    assert done.exit_code == 2, done.output
    assert done.stderr.startswith(f"mqttxt: {said}")
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ("--ttl 61", "--ttl 61: expected more than 0 and at most 60 s"),
        ("--ttl 0", "--ttl 0: expected more than 0 and at most 60 s"),
        ("--ttl nan", "--ttl nan: expected more than 0 and at most 60 s"),
        ("--limit 0", "--limit 0: expected 0.1 to 86400 s"),
        ("--limit 86401", "--limit 86401: expected 0.1 to 86400 s"),
    ],
)
def test_no_control_is_taken_for_a_time_that_no_command_can_have(
    typed: str, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def join(*_: object) -> None:
        raise AssertionError("a station was made")

    monkeypatch.setattr(StationOptions, "joined", join)
    done = CliRunner().invoke(app, shlex.split(f"gs send arm --take-over {typed}"))
    assert (done.exit_code, done.stderr) == (2, f"mqttxt: {said}\n")


@pytest.mark.parametrize(
    ("option", "said"),
    [
        ("--journal", "cannot be written: is a folder; expected a file"),
        ("--audit", "cannot be written: Is a directory; expected a file"),
        ("--parameter-ranges", "Is a directory; expected a file that can be read"),
        ("--mavlink-key", "Is a directory; expected a file that can be read"),
    ],
)
def test_a_folder_in_place_of_a_file_is_named_by_its_option(option: str, said: str, tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    words = ["uav", "--drone", "1", "--broker", "mqtt://127.0.0.1", "--journal", str(tmp_path / "journal")]
    done = CliRunner().invoke(app, [*words, option, str(folder)])
    assert done.exit_code == 2
    assert done.stderr.splitlines()[-1] == f"mqttxt: {option} {folder}: {said}"


def test_the_help_says_how_high_a_takeoff_is_without_a_height() -> None:
    assert Takeoff().altitude_m == 10
    assert "takeoff: [ALTITUDE], 10 m without;" in PARAMETERS


def test_the_line_is_the_same_for_who_runs_the_package() -> None:
    """`python -m mqttxt` is three words of a command's path."""
    done = CliRunner().invoke(app, ["uav", "--drone", "one", "--broker", "x"], prog_name="python -m mqttxt")
    assert done.stderr == "mqttxt: uav: --drone 'one': expected a whole number\n"


def test_a_command_without_words_shows_its_help() -> None:
    for typed in ([], ["gs"], ["gs", "plan"]):
        done = CliRunner().invoke(app, typed)
        assert (done.exit_code, "Commands:" in done.output) == (2, True)


def test_no_broker_is_one_line_that_names_the_options() -> None:
    done = CliRunner().invoke(app, ["gs", "send", "arm", "--cloud", "mqtt://127.0.0.1:1", "--timeout", "0.1"])
    assert done.exit_code == 1
    assert done.stderr.splitlines()[-1].endswith("; expected --cloud (or MQTTXT_CLOUD) and --fog of a running fleet")


@pytest.mark.parametrize(
    ("typed", "wanted"),
    [
        ("send arm --drone 3", (3,)),
        ("send arm", True),
        ("send goto 1 2 3 --best", True),
        ("params list --drone 3", (3,)),
        ("plan clear --drone acme/3", (3,)),
    ],
)
def test_a_command_for_one_drone_wants_control_of_no_other(
    typed: str, wanted: object, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another person's command for another drone of the fog would be denied as long as this one lasts."""

    def made(*_: object, control: object, **more: object) -> None:
        assert control == wanted
        raise ConfigurationError("not made")

    monkeypatch.setattr(ground_station, "GroundStation", made)
    done = CliRunner().invoke(app, ["gs", *shlex.split(typed)])
    assert (done.exit_code, done.stderr) == (2, "mqttxt: not made\n")


def test_a_parameter_of_the_library_is_shown_as_the_commands_option(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(typer.Exit), errors_as_lines():
        raise ConfigurationError("`signed_states`: expected `signed` beside `identity`, and `land` as it is")
    said = "--signed-states: expected --signed beside --identity, and `land` as it is"
    assert capsys.readouterr().err == f"mqttxt: {said}\n"


@pytest.mark.parametrize("ends", [None, StationEnded("left"), BrokerRefused("refused")])
async def test_who_gets_no_last_word_is_told_that_the_command_goes_on(
    ends: Exception | None, capsys: pytest.CaptureFixture[str]
) -> None:
    record = Record[Outcome]()
    following = asyncio.ensure_future(follow(SentCommand(record, last_word)))
    record.hear(outcome(Word.ACCEPTED))
    await asyncio.sleep(0)
    if ends is None:
        following.cancel()
    else:
        record.end(ends)
    (ended,) = await asyncio.gather(following, return_exceptions=True)
    assert isinstance(ended, type(ends) if ends is not None else asyncio.CancelledError)
    printed = capsys.readouterr()
    assert printed.out == "drone 1: takeoff accepted\n"
    said = "no last word: a command that was sent goes on; `mqttxt gs send hold` stops a drone"
    assert printed.err == f"mqttxt: {said}\n"


def test_a_word_that_is_as_wished_is_printed_as_it_is() -> None:
    assert line_of(outcome(Word.COMPLETED)) == "drone 1: takeoff completed"


@pytest.mark.parametrize(
    ("word", "reason", "said"),
    [
        (
            *(Word.DENIED, "not_in_control, gs-page"),
            "drone 1: takeoff denied(not_in_control, gs-page). Refused. It was not started. "
            "Another ground station controls the drone: gs-page. --take-over takes control from it.",
        ),
        (
            *(Word.DENIED, "disarmed"),
            "drone 1: takeoff denied(disarmed). Refused. It was not started. The drone is disarmed: arm it first.",
        ),
        (
            *(Word.UNREACHABLE, None),
            "drone 1: takeoff unreachable. It did not reach the drone. It was not started, and will not be.",
        ),
    ],
)
def test_any_other_word_is_printed_with_what_it_means(word: Word, reason: str | None, said: str) -> None:
    assert line_of(outcome(word, reason=reason)) == said


def test_a_drone_that_a_fog_does_not_have_is_named_beside_those_that_it_has() -> None:
    fog = cast("Fog", FakeStation().the_fog)
    numbers = ", ".join(str(drone.number) for drone in fog.drones)
    assert not_there(fog, fog.drones[0].number) is None
    assert not_there(fog, 9) == f"fog 1: has no drone 9; its drones: {numbers}"
