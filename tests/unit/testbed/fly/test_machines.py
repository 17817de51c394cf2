"""Machines are joined and left as they were found; one that is lost in flight does not cut the mission short."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Generator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from docker.errors import APIError
from requests.exceptions import ConnectionError as NoAnswer
from requests.exceptions import ReadTimeout

from testbed.errors import ContainerDied, DockerError, FleetError, UserError
from testbed.fly.containers import Containers
from testbed.fly.machines import reach
from testbed.fly.machines import spread as spread_module
from testbed.fly.machines.reach import Daemon
from testbed.fly.machines.spread import SpreadContainers
from testbed.fly.machines.swarm import LABEL, forget, joined
from testbed.plan.fleets import standard_fleet
from testbed.plan.machines import Machine

_numbers = itertools.count(1)


class _Node:
    def __init__(self, swarm: _Swarm, docker: _Docker) -> None:
        self.id, self.attrs = docker.node, {"Spec": {"Role": "worker", "Labels": {}}}
        self._swarm = swarm

    def update(self, spec: dict[str, Any]) -> None:
        if self._swarm.refusals:
            raise self._swarm.refusals.pop()
        self.attrs["Spec"] = spec

    def remove(self, force: bool) -> None:
        self._swarm.nodes.remove(self)


class _Swarm:
    """What all of a swarm's daemons know."""

    def __init__(self, labels: dict[str, str]) -> None:
        self.labels = labels
        self.nodes: list[_Node] = []
        self.refusals: list[BaseException] = []
        """What changing a node ends with, last first."""


class _Docker:
    """A daemon as far as swarms go; `address` is its own, where others join."""

    def __init__(self) -> None:
        self.node = f"node{next(_numbers)}"
        self.of: _Swarm | None = None
        self.manages = False
        self.bridge = False
        self.answers = True
        self.is_joining = False
        """It goes on trying to join a swarm that it does not reach."""
        self.swarm = SimpleNamespace(init=self._init, join=self._join, leave=self._leave, attrs={})
        self.nodes = SimpleNamespace(list=lambda: list(self._own.nodes), get=self._get)
        self.networks = SimpleNamespace(get=lambda _: SimpleNamespace(attrs={"Containers": {}}, remove=self._unbridge))

    def info(self) -> dict[str, Any]:
        if not self.answers:
            raise NoAnswer("connection refused")
        state = "pending" if self.is_joining else "inactive" if self.of is None else "active"
        found = {"LocalNodeState": state, "ControlAvailable": self.manages, "NodeAddr": "", "NodeID": self.node}
        return {"Swarm": found}

    @property
    def _own(self) -> _Swarm:
        assert self.of is not None
        return self.of

    def _init(self, labels: dict[str, str]) -> None:
        self.make(labels)

    def make(self, labels: dict[str, str]) -> None:
        self.of, self.manages, self.bridge = _Swarm(labels), True, True
        self.of.nodes.append(_Node(self.of, self))
        self.swarm.attrs = {"Spec": {"Labels": labels}, "JoinTokens": {"Worker": self}}

    def _join(self, addresses: list[str], token: _Docker) -> None:
        self.of, self.bridge = token.of, True
        self._own.nodes.append(_Node(self._own, self))

    def _leave(self, force: bool) -> None:
        if self.of is None and not self.is_joining:
            raise APIError("", explanation="This node is not part of a swarm")
        self.of, self.manages, self.is_joining = None, False, False

    def _get(self, wanted: str) -> _Node:
        return next(node for node in self._own.nodes if node.id == wanted)

    def _unbridge(self) -> None:
        self.bridge = False


def _daemon(name: str, client: Any) -> Daemon:
    return Daemon(Machine(f"unix:///{name}", ("fog1", "uav1")), f"unix:///{name}", client)


def _join(here: _Docker, there: Daemon) -> None:
    """What a run does of swarms that flies nothing."""
    with joined(here, [there]):
        pass


@pytest.fixture
def here() -> _Docker:
    return _Docker()


@pytest.fixture
def there() -> _Docker:
    return _Docker()


def test_a_swarm_that_was_made_is_gone_afterwards(here: _Docker, there: _Docker) -> None:
    with joined(here, [_daemon("a", there)]):
        assert here.of is there.of is not None
    assert (here.of, here.bridge, there.of, there.bridge) == (None, False, None, False)


def test_of_a_swarm_that_was_there_only_who_joined_leaves(here: _Docker, there: _Docker) -> None:
    here.make({})
    member = _Docker()
    member._join([], here)
    with joined(here, [_daemon("a", there), _daemon("b", member)]) as node_ids:
        assert there.of is member.of is here.of
        assert node_ids == {"/a": there.node, "/b": member.node}
    assert there.of is None
    assert member.of is here.of is not None
    assert [node.id for node in here._own.nodes] == [here.node, member.node]


def test_what_a_killed_run_left_is_used_and_taken_apart(here: _Docker, there: _Docker) -> None:
    here.make({LABEL: "made"})
    _join(here, _daemon("a", there))
    assert here.of is there.of is None


def test_a_machine_in_another_swarm_is_named_and_nothing_is_left(here: _Docker, there: _Docker) -> None:
    there.make({})
    with pytest.raises(UserError, match="MACHINES: unix:///a: is in another swarm: expected none"):
        _join(here, _daemon("a", there))
    assert here.of is None
    assert there.of is not None


def test_a_machine_that_cannot_join_is_named_with_the_port_that_it_needs(here: _Docker, there: _Docker) -> None:
    def refuse(*_: object) -> None:
        raise APIError("", explanation="Timeout was reached before node joined")

    there.swarm.join = refuse
    with pytest.raises(UserError, match=r"unix:///a: Timeout .*expected a machine that reaches TCP port 2377"):
        _join(here, _daemon("a", there))
    assert here.of is None


def test_a_machine_that_is_gone_at_the_end_is_named_and_the_others_leave(here: _Docker, there: _Docker) -> None:
    lost = _Docker()
    left = (
        r"^/a: does not answer; type there: "
        r"docker swarm leave --force; docker rm -f \$\(docker ps -aqf name=mqttxt-testbed\)$"
    )
    with pytest.raises(DockerError, match=left), joined(here, [_daemon("a", lost), _daemon("b", there)]):
        lost.answers = False
    assert here.of is there.of is None


def test_of_machines_that_are_lost_only_who_joined_is_forgotten(here: _Docker, there: _Docker) -> None:
    here.make({})
    member = _Docker()
    member._join([], here)
    with joined(here, [_daemon("a", there), _daemon("b", member)]) as node_ids:
        for node_id in node_ids.values():
            forget(here, node_id)
        assert [node.id for node in here._own.nodes] == [here.node, member.node]


def test_a_run_that_is_interrupted_before_a_node_has_its_label_leaves_no_machine_in_a_swarm(
    here: _Docker, there: _Docker
) -> None:
    here.make({})
    here._own.refusals = [KeyboardInterrupt()]
    with pytest.raises(KeyboardInterrupt):
        _join(here, _daemon("a", there))
    assert there.of is None
    assert [node.id for node in here._own.nodes] == [here.node]


def test_what_was_killed_before_a_node_had_its_label_is_taken_apart_by_the_next_run(
    here: _Docker, there: _Docker
) -> None:
    here.make({LABEL: "made"})
    there._join([], here)
    _join(here, _daemon("a", there))
    assert here.of is there.of is None


def test_a_run_that_is_interrupted_while_the_swarm_is_made_leaves_none(here: _Docker, there: _Docker) -> None:
    def interrupted(labels: dict[str, str]) -> None:
        here.make(labels)
        raise KeyboardInterrupt

    here.swarm.init = interrupted
    with pytest.raises(KeyboardInterrupt):
        _join(here, _daemon("a", there))
    assert here.of is None


def test_a_machine_that_goes_on_joining_though_nobody_waits_is_stopped(here: _Docker, there: _Docker) -> None:
    def hang(*_: object) -> None:
        there.is_joining = True
        raise ReadTimeout("Read timed out. (read timeout=20)")

    there.swarm.join = hang
    with pytest.raises(UserError, match=r"^MACHINES: unix:///a: Read timed out.*: expected a machine that reaches TCP"):
        _join(here, _daemon("a", there))
    assert not there.is_joining
    assert here.of is None


def test_a_node_that_changes_meanwhile_is_labelled_all_the_same(here: _Docker, there: _Docker) -> None:
    here.make({})
    here._own.refusals = [APIError("", explanation="rpc error: update out of sequence")]
    with joined(here, [_daemon("a", there)]):
        assert here._get(there.node).attrs["Spec"]["Labels"] == {LABEL: "joined"}


def test_nobody_is_told_to_take_a_machine_out_of_a_swarm_that_it_was_in_before(here: _Docker) -> None:
    here.make({})
    member = _Docker()
    member._join([], here)
    with joined(here, [_daemon("a", member)]):
        member.answers = False
    assert member.of is here.of is not None


def test_a_worker_of_a_swarm_is_no_place_to_type_it_and_stays_one(here: _Docker, there: _Docker) -> None:
    there.make({LABEL: "made"})
    here._join([], there)
    with pytest.raises(UserError, match="expected this machine in no swarm"):
        _join(here, _daemon("a", there))
    assert here.of is there.of is not None


class _There:
    """The containers of another machine, which `error` happens to."""

    def __init__(self) -> None:
        self.error: Exception | None = None
        self.asked = 0

    def check_alive(self) -> None:
        self.asked += 1
        if self.error is not None:
            raise self.error

    def _all(self) -> list[str]:
        return ["there"]


@pytest.fixture
def spread(monkeypatch: pytest.MonkeyPatch) -> tuple[SpreadContainers, _There]:
    fleet, there = SpreadContainers.__new__(SpreadContainers), _There()
    fleet._others, fleet._lost = {"a": there}, {}  # type: ignore[dict-item]

    def run(self: Containers, *_: object, **__: object) -> Generator[str, None, int]:
        for line in ("first", "mission: land: drone 4: unreachable"):
            yield line
            self.check_alive()
        return 1

    monkeypatch.setattr(Containers, "check_alive", lambda self: None)
    monkeypatch.setattr(Containers, "execute", run)
    monkeypatch.setattr(Containers, "_all", lambda self: ["here"])
    return fleet, there


def test_a_machine_that_is_lost_fails_the_flight_once_the_mission_has_ended(
    spread: tuple[SpreadContainers, _There],
) -> None:
    fleet, there = spread
    there.error = DockerError("Docker does not answer: refused")
    running, lines = fleet.execute("gs", ["mission"], limit_s=1), []
    with pytest.raises(FleetError) as error:
        lines.extend(running)
    assert str(error.value) == (
        "a was lost in flight: Docker does not answer: refused; mission: land: drone 4: unreachable"
    )
    assert there.asked == 1
    assert fleet._all() == ["here"]


def test_a_container_that_ends_on_another_machine_ends_the_flight(spread: tuple[SpreadContainers, _There]) -> None:
    fleet, there = spread
    there.error = ContainerDied("uav4 ended with exit code 137")
    with pytest.raises(ContainerDied, match="uav4"):
        list(fleet.execute("gs", ["mission"], limit_s=1))


def test_a_machine_whose_overlays_carry_nothing_is_told_which_ports_it_needs(
    spread: tuple[SpreadContainers, _There], monkeypatch: pytest.MonkeyPatch
) -> None:
    fleet, _ = spread
    fleet._fleet, fleet._machines = standard_fleet(), [Machine("ssh://a", ("fog1",)), Machine("ssh://b", ("fog2",))]
    asked: list[tuple[str, list[str]]] = []

    def ping(self: Containers, node: str, command: list[str]) -> str:
        asked.append((node, command))
        return f"15 packets transmitted, {int(asked.count(('fog1', command)) == 2)} received"

    monkeypatch.setattr(Containers, "start", lambda self, *services: None)
    monkeypatch.setattr(Containers, "output", ping)
    fleet.start("client1")
    assert asked == []
    with pytest.raises(UserError) as error:
        fleet.start("net", "fog1", "fog2")
    assert str(error.value) == (
        "MACHINES: ssh://b: no answer from net to fog2 there within 75 s: "
        "expected UDP port 4789, and UDP and TCP port 7946, to be open between all machines"
    )
    assert asked[:3] == [*[("fog1", ["ping", "-c", "1", "-w", "15", "198.18.11.2"])] * 2, ("fog2", asked[2][1])]
    assert len(asked) == 7


def test_a_machine_that_cannot_be_fetched_from_or_cleared_keeps_no_other_from_it(
    spread: tuple[SpreadContainers, _There], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fleet, _ = spread
    done: list[str] = []

    def made(name: str) -> Any:
        def act(what: str) -> None:
            done.append(f"{what} {name}")
            if name == "a":
                raise DockerError("Docker does not answer")

        return SimpleNamespace(down=lambda: act("down"), fetch=lambda *_: act("fetch"), remove=lambda: act("remove"))

    both: dict[str, Any] = {name: made(name) for name in "ab"}
    fleet._others, fleet._carriers, fleet._run_dir, fleet._client = both, both, tmp_path, SimpleNamespace()  # type: ignore[assignment]
    monkeypatch.setattr(Containers, "save_logs", lambda self, folder: None)
    monkeypatch.setattr(Containers, "down", lambda self: done.append("down here"))
    monkeypatch.setattr(spread_module, "remove_overlays", lambda here: done.append("overlays"))
    with pytest.raises(DockerError):
        fleet.save_logs(tmp_path)
    with pytest.raises(DockerError):
        fleet.down()
    assert sorted(done) == sorted(
        ["fetch a", "fetch b", "down here", "down a", "remove a", "down b", "remove b", "overlays"]
    )


def _ssh(folder: Path, monkeypatch: pytest.MonkeyPatch, script: str) -> None:
    path = folder / "ssh"
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(0o755)
    monkeypatch.setenv("PATH", str(folder), prepend=":")


def _refused() -> str:
    """What is said of a machine whose socket ssh does not forward."""
    with pytest.raises(UserError) as error, reach._socket_of(Machine("ssh://a", ())):
        pass
    return str(error.value)


def test_the_socket_of_a_far_machine_is_forwarded_and_ssh_ends_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _ssh(tmp_path, monkeypatch, f'echo "$$ $@" > {tmp_path}/said; while [ "$1" != -L ]; do shift; done; '
         'touch "${2%%:*}"; exec sleep 60')  # fmt: skip
    with reach._socket_of(Machine("ssh://ops@a:2222", ())) as address:
        process, *words = (tmp_path / "said").read_text().split()
        assert address.startswith("unix:///")
        assert words[-3:] == ["-p", "2222", "ops@a"]
        assert f"{address.removeprefix('unix://')}:/var/run/docker.sock" in words
        assert "ControlPath=none" in words, "a connection that others share would go on afterwards, with the socket"
        assert "ExitOnForwardFailure=no" in words, "a port that the user's own ssh forwards already is no hindrance"
    assert not Path(f"/proc/{process}").exists()
    assert not Path(address.removeprefix("unix://")).parent.exists()


def test_ssh_may_say_more_than_a_pipe_holds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reach, "OPENED_S", 5.0)
    _ssh(tmp_path, monkeypatch, 'seq 30000 >&2; while [ "$1" != -L ]; do shift; done; touch "${2%%:*}"; exec sleep 60')
    with reach._socket_of(Machine("ssh://a", ())) as address:
        assert Path(address.removeprefix("unix://")).exists()


def test_a_socket_that_ssh_does_not_forward_in_time_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reach, "OPENED_S", 0.3)
    _ssh(tmp_path, monkeypatch, "echo Could not request local forwarding. >&2; exec sleep 60")
    said = "ssh has not forwarded /var/run/docker.sock within 0.3 s: Could not request local forwarding"
    assert _refused() == f"MACHINES: ssh://a: {said}"


def test_a_far_machine_where_no_docker_may_be_used_is_told_what_was_expected(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As with a real sshd: ssh takes the connection, and closes it when sshd opens none to the socket."""
    opens = """import socket, sys
listener = socket.socket(socket.AF_UNIX)
listener.bind(sys.argv[1])
listener.listen()
while True:
    listener.accept()[0].close()"""
    (tmp_path / "opens.py").write_text(opens)
    _ssh(tmp_path, monkeypatch, 'while [ "$1" != -L ]; do shift; done; '
         f'exec {sys.executable} {tmp_path}/opens.py "${{2%%:*}}"')  # fmt: skip
    with pytest.raises(UserError) as error, reach.reached([Machine("ssh://a", ())], "node"):
        pass
    assert str(error.value).startswith("MACHINES: ssh://a: Docker does not answer: ")
    expected = "this user may use and sshd forwards (AllowStreamLocalForwarding)"
    assert str(error.value).endswith(f": expected Docker's /var/run/docker.sock there, which {expected}")


def test_a_machine_that_ssh_does_not_reach_is_named_with_what_ssh_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _ssh(tmp_path, monkeypatch, "echo a: Permission denied >&2; exit 255")
    expected = "expected a machine that ssh reaches without asking"
    assert _refused() == f"MACHINES: ssh://a: a: Permission denied: {expected}"


def test_what_ssh_says_is_one_line_whatever_bytes_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _ssh(tmp_path, monkeypatch, r"printf 'banner\n\377\376 \033[2J no\tentry\n' >&2; exit 255")
    said = _refused()
    assert said.isprintable()
    assert "no entry: expected a machine that ssh reaches without asking" in said


def test_a_machine_without_ssh_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "/nowhere")
    assert _refused() == "MACHINES: ssh://a: expected ssh to be installed here"
