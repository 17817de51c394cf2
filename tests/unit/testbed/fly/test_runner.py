"""The order of a run, and how it ends when something goes wrong, with a fleet that is made up."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import signal
import time
from collections.abc import Generator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from testbed.errors import (
    ContainerDied,
    ContainerUnhealthy,
    DockerError,
    Interrupted,
    ProbesLate,
    TestbedError,
    UserError,
)
from testbed.fly import flight_logs, runner
from testbed.fly.calibration.calibrate import Calibration
from testbed.fly.quiet import Waited
from testbed.fly.results import Attempt, Series, new_series, read_json
from testbed.fly.runner import run_series
from testbed.fly.validity import WATCHED, Verdict
from testbed.plan.experiments import Plan, make_plan
from tests.handmade.made_up_fleet import CALIBRATED, OFF, Fleet, Quiet


@pytest.fixture(autouse=True)
def calibrations(monkeypatch: pytest.MonkeyPatch) -> list[Calibration]:
    """What the probes find from now on, the last of them again and again."""
    found = [CALIBRATED]
    monkeypatch.setattr(runner, "calibrate", lambda *_: found.pop(0) if len(found) > 1 else found[0])
    return found


TAKEOFF = json.dumps({"at_s": 7.5, "step": "takeoff", "drones": {"1": "armed, 3.0 m"}})


def _fly(
    root: Path, fleet: Fleet, attempts: str = "1", protocols: str = "mqttxt", **factors: str
) -> tuple[Path, list[Verdict], Quiet]:
    progress = Quiet()
    plan = make_plan("scenario-1", attempts, "thesis", "ideal", protocols, factors)
    series, endings = _run(root, plan, fleet, progress)
    return series.path, endings, progress


def _run(root: Path, plan: Plan, fleet: Fleet, progress: Quiet | None = None) -> tuple[Series, list[Verdict]]:
    series = new_series(root, plan.experiment, plan.label, plan.profile.name)
    return series, run_series(plan, series, progress or Quiet(), fleet)


def _manifest(root: Path, protocol: str = "mqttxt", number: int = 1) -> dict[str, Any]:
    (path,) = root.glob(f"scenario-1/*-ideal/*/{protocol}/attempt-{number:02d}/manifest.json")
    found: dict[str, Any] = json.loads(path.read_text())
    return found


def test_a_run_goes_up_flies_and_ends_the_captures_before_the_rest(tmp_path: Path) -> None:
    fleet = Fleet([TAKEOFF, "something else"])
    path, endings, progress = _fly(tmp_path, fleet)
    assert fleet.did == ["down", "network", "fleet", "mission in gs", "stop net", "logs", "down"]
    assert endings == [Verdict("completed")]
    assert ("takeoff", {"1": "armed, 3.0 m"}) in progress.said
    manifest = _manifest(tmp_path)
    assert manifest["status"] == "completed"
    assert manifest["versions"]["mosquitto"] == "2.0.21"
    assert (manifest["cpu_s"], manifest["memory_bytes"]) == ({"gs": 1.0, "net": 2.0}, {"gs": 4096})
    assert 0 <= manifest["host"]["others"] <= 1
    assert (tmp_path / "scenario-1" / "latest").resolve() == path.resolve()


def test_a_mission_of_ones_own_is_copied_to_where_its_node_sees_it(tmp_path: Path) -> None:
    mission = tmp_path / "search.py"
    mission.write_text("async def mission(fleet, steps): ...\n")
    fleet = Fleet([])
    series, endings = _run(tmp_path, make_plan(str(mission), protocols="mqttxt"), fleet)
    assert endings == [Verdict("completed")]
    assert (series.path / "mqttxt" / "attempt-01" / "search.py").read_text() == mission.read_text()
    assert fleet.commands[0][2] == "/run-dir/search.py"


def test_with_sensors_their_nodes_run_their_links_are_gated_and_not_probed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    unprobed: list[Any] = []
    monkeypatch.setattr(runner, "calibrate", lambda *told: unprobed.append(told[3]) or CALIBRATED)
    series, _ = _run(tmp_path, make_plan("scenario-4", protocols="mqttxt"), Fleet([]))
    attempt, *_ = series.attempts()
    gated = {gate["link"] for gate in read_json(attempt.path / "links" / "plan.json")["gates"]}
    assert gated == set(unprobed[0]) == {f"sense:uav{drone}" for drone in range(1, 7)}
    assert len(attempt.topology().nodes) == 16


def test_a_secured_fleet_has_its_identities_before_its_roles_start_and_mavlink_has_none(tmp_path: Path) -> None:
    fleet = Fleet([TAKEOFF])
    _, endings, _ = _fly(tmp_path, fleet, protocols="mqttxt,mavlink", security="tls")
    assert endings == [Verdict("completed")] * 2
    assert fleet.did[:5] == ["down", "network", "identities", "fleet", "mission in gs"]
    assert fleet.did.count("identities") == 1


def test_where_an_identity_cannot_be_made_the_attempt_fails_with_what_was_said(tmp_path: Path) -> None:
    class Full(Fleet):
        def execute(self, service: str, command: list[str], *, limit_s: float) -> Generator[str, None, int]:
            yield "mqttxt: /run/fleet/testbed: No space left on device"
            return 2

    _, endings, _ = _fly(tmp_path, Full([TAKEOFF]), security="tls")
    reason = "the fleet's identities: mqttxt: /run/fleet/testbed: No space left on device"
    assert endings == [Verdict("failed", (reason,))]


def test_a_failed_mission_keeps_its_reason_and_the_series_goes_on(tmp_path: Path) -> None:
    _, endings, _ = _fly(tmp_path, Fleet(["mission: scenario-1 failed: arm: drone 3: denied"], code=1), attempts="2")
    assert endings == [Verdict("failed", ("scenario-1 failed: arm: drone 3: denied",))] * 2


def test_a_container_that_dies_fails_the_attempt_by_its_name(tmp_path: Path) -> None:
    fleet = Fleet([TAKEOFF], raises=ContainerDied("uav3 ended with exit code 137; its last log lines:\n    bye"))
    _, endings, _ = _fly(tmp_path, fleet)
    assert endings[0].status == "failed"
    assert str(endings[0].reason).startswith("uav3 ended with exit code 137")
    assert fleet.did[-3:] == ["stop net", "logs", "down"]


def test_a_capture_that_dropped_makes_the_attempt_void_and_it_is_repeated_twice_when_the_machine_is_quieter(
    tmp_path: Path, waits: list[Waited]
) -> None:
    path, endings, progress = _fly(tmp_path, Fleet([TAKEOFF], dropped=2))
    assert endings == [Verdict("void", ("captures dropped packets: gs 2",))]
    flown = Series(path).attempts()
    assert [one.path.name for one in flown] == ["attempt-01", "attempt-01-repeat-1", "attempt-01-repeat-2"]
    assert [entry for entry in progress.said if entry[0] == "mqttxt"] == [("mqttxt", 1, 1, n) for n in range(3)]
    assert len(waits) == 2
    hosts = [one.manifest()["host"] for one in flown]
    assert [(host.get("waited_s"), host.get("idle")) for host in hosts] == [(None, None), (2.0, 0.9), (2.0, 0.9)]
    assert "waiting until 60% of the processors are idle, 300 s at most" in str(progress.said)


@pytest.mark.parametrize("code", [0, 1])
def test_a_clock_that_is_set_forward_in_flight_makes_the_attempt_void(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int
) -> None:
    class Jumps(Fleet):
        def execute(self, service: str, command: list[str], *, limit_s: float) -> Generator[str, None, int]:
            code = yield from super().execute(service, command, limit_s=limit_s)
            if len(self.profiles) == 1:
                now_ns = time.time_ns
                monkeypatch.setattr(time, "time_ns", lambda: now_ns() + 3_600_000_000_000)
            return code

    path, endings, _ = _fly(tmp_path, Jumps([TAKEOFF, "mission: denied"], code=code))
    first = Series(path).attempts()[0].manifest()
    assert first["status"] == "void"
    assert first["reason"].startswith("the machine's clock was set forward, or the machine was suspended, by 3600.0")
    assert endings == [Verdict("failed", ("denied",)) if code else Verdict("completed")]


def test_a_flight_whose_log_says_otherwise_is_void(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flight_logs, "against", lambda _: "uav3: events and flight log disagree: landed")
    _, endings, _ = _fly(tmp_path, Fleet([TAKEOFF]))
    assert endings == [Verdict("void", ("uav3: events and flight log disagree: landed",))]


def test_where_one_protocol_is_void_its_pair_is_and_both_are_flown_again(tmp_path: Path) -> None:
    class Late(Fleet):
        def count_links(self, void: str | None = None) -> None:
            second = self.profiles == ["mqttxt", "mavlink"]
            super().count_links("the emulator did not keep up" if second else None)

    path, endings, _ = _fly(tmp_path, Late([TAKEOFF]), protocols="mqttxt,mavlink")
    assert endings == [Verdict("completed")] * 2
    told = {
        str(attempt.path.relative_to(path)): (attempt.manifest()["status"], attempt.manifest()["reason"])
        for attempt in Series(path).attempts()
    }
    assert told == {
        "mavlink/attempt-01": ("void", "the emulator did not keep up"),
        "mavlink/attempt-01-repeat-1": ("completed", None),
        "mqttxt/attempt-01": ("void", "mavlink was void in the same attempt"),
        "mqttxt/attempt-01-repeat-1": ("completed", None),
    }


def test_nothing_is_flown_on_links_that_are_not_what_the_profile_says(
    tmp_path: Path, calibrations: list[Calibration]
) -> None:
    calibrations[:] = [OFF, CALIBRATED]
    fleet = Fleet([TAKEOFF])
    path, endings, _ = _fly(tmp_path, fleet)
    assert fleet.did[:5] == ["down", "network", "stop net", "logs", "down"]
    assert endings == [Verdict("completed")]
    void, flown = (attempt.manifest() for attempt in Series(path).attempts())
    assert void["status"] == "void"
    assert void["reason"].startswith("wan:gs:up delay: configured 0 ms, measured 9 ms (10 of 10 probes arrived)")
    assert flown["calibration"]["off"] == []


def test_a_machine_too_busy_to_measure_its_links_fails_nobody(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found: list[Calibration | ProbesLate] = [ProbesLate("gs: the probe began 25 ms late"), CALIBRATED]

    def calibrated(*_: Any) -> Calibration:
        first = found.pop(0)
        if isinstance(first, ProbesLate):
            raise first
        return first

    monkeypatch.setattr(runner, "calibrate", calibrated)
    path, endings, _ = _fly(tmp_path, Fleet([TAKEOFF]))
    assert endings == [Verdict("completed")]
    void, _ = (attempt.manifest() for attempt in Series(path).attempts())
    assert (void["status"], void["reason"]) == ("void", "gs: the probe began 25 ms late")


def test_random_loss_that_chance_does_not_explain_makes_an_attempt_void(tmp_path: Path) -> None:
    class Lossy(Fleet):
        def count_links(self, void: str | None = None) -> None:
            super().count_links()
            path = self._run_dir / "links" / "counters.json"
            link = {"random": 40, "left": 1000}
            path.write_text(json.dumps(json.loads(path.read_text()) | {"links": {"air:uav1:up": link}}))

    path, endings, _ = _fly(tmp_path, Lossy([TAKEOFF]))
    assert endings[0].status == "void"
    assert "air:uav1:up" in str(endings[0].reason)
    kept = read_json(Series(path).attempts()[0].path / "links" / "calibration.json")
    loss = kept["links"]["air:uav1:up"]["loss"]
    assert (loss["configured"], loss["measured"], loss["lost"]) == (0.0, 40 / 1040, 40)


class FailsFirst(Fleet):
    """The first flight's mission fails; the shaper is late in the last of the flights `late`."""

    late = ("mqttxt",)

    def execute(self, service: str, command: list[str], *, limit_s: float) -> Generator[str, None, int]:
        yield from super().execute(service, command, limit_s=limit_s)
        if self.profiles == ["mqttxt"]:
            yield "mission: scenario-1 failed: arm: drone 3: denied"
            return 1
        return 0

    def count_links(self, void: str | None = None) -> None:
        super().count_links("the emulator did not keep up" if tuple(self.profiles) == self.late else None)


def test_a_failure_beside_a_void_attempt_is_void_and_says_so(tmp_path: Path) -> None:
    class LateAfterwards(FailsFirst):
        late = ("mqttxt", "mavlink")

    path, endings, _ = _fly(tmp_path, LateAfterwards([TAKEOFF]), protocols="mqttxt,mavlink")
    assert endings == [Verdict("completed")] * 2
    first = Series(path).attempts()[2].manifest()
    assert first["status"] == "void"
    assert first["reason"] == (
        "mavlink was void in the same attempt; this one had failed: scenario-1 failed: arm: drone 3: denied"
    )


def test_a_mission_that_failed_on_other_links_than_planned_is_void_says_so_and_is_repeated(tmp_path: Path) -> None:
    path, endings, _ = _fly(tmp_path, FailsFirst([TAKEOFF]), protocols="mqttxt,mavlink")
    assert endings == [Verdict("completed")] * 2
    told = Series(path).attempts()
    reasons = {str(attempt.path.relative_to(path)): attempt.manifest()["reason"] for attempt in told}
    assert reasons == {
        "mqttxt/attempt-01": (
            "the emulator did not keep up; this one had failed: scenario-1 failed: arm: drone 3: denied"
        ),
        "mqttxt/attempt-01-repeat-1": None,
        "mavlink/attempt-01-repeat-1": None,
    }


def test_links_that_cannot_be_shaped_end_the_run_with_what_net_says(tmp_path: Path) -> None:
    class Unshaped(Fleet):
        def start(self, *services: str) -> None:
            raise ContainerDied("net ended with exit code 1; its last log lines:\n    …")

        def last_words(self, service: str) -> str | None:
            return "net: neither netem nor NFQUEUE"

    fleet = Unshaped([TAKEOFF])
    with pytest.raises(TestbedError, match=r"^the links cannot be shaped: net: neither netem nor NFQUEUE$"):
        _fly(tmp_path, fleet)
    assert fleet.did[-1] == "down"
    assert _manifest(tmp_path)["status"] == "void"


def test_what_shapes_the_links_and_their_seed_are_in_the_manifest(tmp_path: Path) -> None:
    _fly(tmp_path, Fleet([TAKEOFF]))
    manifest = _manifest(tmp_path)
    assert (manifest["shaper"], manifest["shaping"]["why"]) == ("nfqueue", "the kernel has no netem")
    (plan,) = tmp_path.glob("scenario-1/*/*/mqttxt/attempt-01/links/plan.json")
    assert json.loads(plan.read_text())["plan"]["seed"] == manifest["seeds"]["links"]


@pytest.mark.parametrize(
    ("broken", "ending"), [("usage", ["stop net", "logs"]), ("stop", ["logs"]), ("save_logs", ["stop net"])]
)
def test_the_containers_end_although_the_disk_is_full(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, broken: str, ending: list[str]
) -> None:
    def fail(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Fleet, broken, fail)
    fleet = Fleet([TAKEOFF])
    with pytest.raises(TestbedError, match=r"attempt-01: No space left on device; the containers are ended") as full:
        _fly(tmp_path, fleet)
    assert full.value.exit_code == 1
    assert fleet.did[4:] == [*ending, "down"]
    assert _manifest(tmp_path)["status"] == "void"
    assert _manifest(tmp_path)["reason"].endswith("No space left on device")


def test_a_signal_while_the_containers_end_waits_for_them(tmp_path: Path) -> None:
    class Late(Fleet):
        def stop(self, service: str) -> None:
            super().stop(service)
            os.kill(os.getpid(), signal.SIGINT)

    fleet = Late([TAKEOFF])
    with pytest.raises(Interrupted):
        _fly(tmp_path, fleet)
    assert fleet.did == ["down", "network", "fleet", "mission in gs", "stop net", "logs", "down"]
    assert _manifest(tmp_path)["status"] == "completed"  # the mission was, before the signal came


def test_a_mission_that_is_killed_fails_its_attempt_only(tmp_path: Path) -> None:
    _, endings, _ = _fly(tmp_path, Fleet([TAKEOFF], code=137), attempts="2")
    assert endings == [Verdict("failed", ("the mission's process ended with exit code 137",))] * 2


def test_a_mission_that_breaks_says_with_what(tmp_path: Path) -> None:
    path, endings, _ = _fly(tmp_path, Fleet(["Traceback (most recent call last):", "KeyError: 7", ""], code=1))
    assert endings == [Verdict("failed", ("the mission's process ended with exit code 1: KeyError: 7",))]
    log = path / "mqttxt" / "attempt-01" / "logs" / "mission.log"
    assert log.read_text().splitlines()[:2] == ["Traceback (most recent call last):", "KeyError: 7"]


def test_a_mission_that_does_not_take_its_input_ends_the_run(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="the mission could not be flown: fleet=1:0: expected drones"):
        _fly(tmp_path, Fleet(["mission: fleet=1:0: expected drones"], code=2))
    assert _manifest(tmp_path)["reason"].startswith("the run was cut off: the mission could not be flown")


def test_a_docker_that_is_lost_in_flight_counts_against_nobody_and_the_attempt_is_flown_again(tmp_path: Path) -> None:
    class Lost(Fleet):
        def execute(self, service: str, command: list[str], *, limit_s: float) -> Generator[str, None, int]:
            yield from super().execute(service, command, limit_s=limit_s)
            if len(self.profiles) == 1:
                raise DockerError("gs: lost touch with python, which still runs")
            return 0

    path, endings, _ = _fly(tmp_path, Lost([TAKEOFF]))
    assert endings == [Verdict("completed")]
    cut, _ = (attempt.manifest() for attempt in Series(path).attempts())
    assert cut["status"] == "void"
    assert cut["reason"] == "the run was cut off: gs: lost touch with python, which still runs"


def test_a_docker_that_is_lost_in_each_flight_ends_the_series_after_three_and_says_why(tmp_path: Path) -> None:
    fleet = Fleet([TAKEOFF], raises=DockerError("gs: lost touch with python, which still runs"))
    said = (
        r"mavlink/attempt-01-repeat-2: the run was cut off: gs: lost touch with python.*, in the last of its repeats$"
    )
    with pytest.raises(DockerError, match=said):
        _fly(tmp_path, fleet, attempts="2", protocols="mavlink")
    assert fleet.profiles == ["mavlink"] * 3


@pytest.mark.parametrize(("code", "status"), [(1, "failed"), (0, "void")])
def test_a_docker_that_cannot_end_the_fleet_takes_no_failure_from_its_mission(
    tmp_path: Path, code: int, status: str
) -> None:
    class Left(Fleet):
        def down(self) -> None:
            super().down()
            if self.did.count("down") == 2:
                raise DockerError("compose down: did not end within 200 s")

    denied = "scenario-1 failed: arm: drone 3: denied"
    path, _, _ = _fly(tmp_path, Left([TAKEOFF, f"mission: {denied}"], code=code))
    first = Series(path).attempts()[0].manifest()
    assert first["status"] == status
    assert first["reason"] == (denied if code else "the run was cut off: compose down: did not end within 200 s")


def test_a_fleet_that_never_comes_up_fails_its_attempt_and_the_run_goes_on(tmp_path: Path) -> None:
    class Broken(Fleet):
        def start(self, *services: str) -> None:
            super().start(*services)
            if self.profiles[-1] == "mavlink" and not services:
                raise ContainerUnhealthy("router-uav3 not healthy within 90 s")

    fleet = Broken([TAKEOFF])
    _, endings, _ = _fly(tmp_path, fleet, protocols="mavlink,mqttxt")
    assert endings == [Verdict("failed", ("router-uav3 not healthy within 90 s",)), Verdict("completed")]
    ends = ["stop net", "logs", "down"]
    assert fleet.did == ["down", "network", "fleet", *ends, "down", "network", "fleet", "mission in gs", *ends]
    assert _manifest(tmp_path, "mavlink")["reason"] == "router-uav3 not healthy within 90 s"


def test_a_lost_docker_ends_the_run_and_what_was_flown_is_kept(tmp_path: Path) -> None:
    class Lost(Fleet):
        def __call__(self, profile: str, run_dir: Path, settings: dict[str, str], fleet: Any) -> Any:
            if profile == "mavlink":
                raise DockerError("Docker does not answer")
            return super().__call__(profile, run_dir, settings, fleet)

    with pytest.raises(DockerError, match="Docker does not answer"):
        _fly(tmp_path, Lost([TAKEOFF]), "2", "mqttxt,mavlink")
    assert _manifest(tmp_path)["status"] == "completed"
    lost = _manifest(tmp_path, "mavlink")
    assert (lost["status"], lost["reason"]) == ("void", "the run was cut off: Docker does not answer")
    assert not list(tmp_path.glob("scenario-1/thesis-ideal/*/*/attempt-02"))
    assert (tmp_path / "scenario-1" / "latest" / "mqttxt" / "attempt-01").exists()


def test_both_protocols_fly_in_each_attempt_and_who_is_first_alternates(tmp_path: Path) -> None:
    fleet = Fleet([TAKEOFF])
    _, endings, progress = _fly(tmp_path, fleet, "2", "mqttxt,mavlink")
    assert fleet.profiles == ["mqttxt", "mavlink", "mavlink", "mqttxt"]
    assert endings == [Verdict("completed")] * 4
    assert [entry for entry in progress.said if entry[1:] == (2, 2, 0)] == [("mavlink", 2, 2, 0), ("mqttxt", 2, 2, 0)]
    assert _manifest(tmp_path, "mqttxt", 1)["order"] == ["mqttxt", "mavlink"]
    assert _manifest(tmp_path, "mqttxt", 2)["order"] == ["mavlink", "mqttxt"]


def test_a_factor_reaches_containers_mission_manifest_and_path(tmp_path: Path) -> None:
    fleet = Fleet([TAKEOFF])
    path, _, progress = _fly(tmp_path, fleet, protocols="mavlink", streams="px4-gcs", chain="shared", qos="1")
    assert path.parent.name == "thesis+streams-px4-gcs+qos-1+chain-shared-ideal"
    assert (fleet.settings["STREAMS"], fleet.settings["CHAIN"], fleet.settings["QOS"]) == ("px4-gcs", "shared", "1")
    assert fleet.commands[0][-4:] == ["--streams", "px4-gcs", "--commanding", "one-by-one"]
    assert "starting the network and its 10 nodes" in progress.said
    assert "starting 12 containers on them" in progress.said
    configuration = _manifest(tmp_path, "mavlink")["configuration"]
    assert configuration == {
        **{"streams": "px4-gcs", "commanding": "one-by-one", "qos": 1, "chain": "shared", "states": "on-change"},
        **{"security": "none", "station": "mqttxt", "tcp": "default", "air": "tcp"},
        **fleet.settings,
    }


def test_the_manifest_has_the_versions_of_what_carried_the_protocol(tmp_path: Path) -> None:
    _fly(tmp_path, Fleet([TAKEOFF]), protocols="mqttxt,mavlink")
    mqttxt, mavlink = (_manifest(tmp_path, protocol)["versions"] for protocol in ("mqttxt", "mavlink"))
    assert mqttxt["mosquitto"] == "2.0.21"
    assert mqttxt.keys() & {"mavsdk", "mavp2p"} == set()
    assert mavlink["mavsdk"] == "4.1.0"
    assert "mavp2p" in mavlink
    assert mavlink.keys() & {"mosquitto", "paho-mqtt"} == set()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_everything_and_keeps_what_there_is(tmp_path: Path, number: int) -> None:
    class Interrupting(Fleet):
        def execute(self, service: str, command: list[str], *, limit_s: float) -> Generator[str, None, int]:
            yield from super().execute(service, command, limit_s=limit_s)
            os.kill(os.getpid(), number)
            return 0

    before = signal.getsignal(number)
    fleet = Interrupting([TAKEOFF])
    with pytest.raises(Interrupted) as interrupted:
        _fly(tmp_path, fleet)
    assert interrupted.value.exit_code == 130
    assert fleet.did[-3:] == ["stop net", "logs", "down"]
    assert (_manifest(tmp_path)["status"], _manifest(tmp_path)["reason"]) == ("void", "interrupted")
    assert signal.getsignal(number) is before


def test_what_the_page_shows_is_flown_once_over_both_marked_and_not_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown: list[str] = []

    @contextlib.contextmanager
    def page_beside(plan: Plan, attempt: Attempt) -> Generator[None]:
        shown.append(attempt.protocol)
        yield

    monkeypatch.setattr(runner, "page_beside", page_beside)
    plan = replace(make_plan("scenario-1", protocols="mqttxt,mavlink"), page=8080)
    series, endings = _run(tmp_path, plan, Fleet([]))
    assert endings == [Verdict("void", (WATCHED,))] * 2
    assert shown == ["mqttxt", "mavlink"]
    assert series.path.parent.name == "thesis+page-ideal"
    for manifest in (attempt.manifest() for attempt in series.attempts()):
        assert (manifest["status"], manifest["reason"]) == ("void", WATCHED)
        assert manifest["observed"]["watched"] is True
    assert not (tmp_path / "scenario-1" / "latest").exists()


def test_a_watched_mission_that_fails_keeps_its_reason(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runner, "page_beside", lambda *_: contextlib.nullcontext())
    plan = replace(make_plan("scenario-1", protocols="mqttxt"), page=8080)
    _, (ending,) = _run(tmp_path, plan, Fleet(["mission: denied"], 1))
    assert ending == Verdict("void", (WATCHED,), "denied")
