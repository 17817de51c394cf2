"""One Docker Swarm of this machine and the others: made where there is none, and left as it was found.

What was made has a label, in the swarm or at its nodes, so that a run whose predecessor was killed takes that apart.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Sequence
from typing import Any

from docker.errors import APIError, NotFound
from requests.exceptions import RequestException

from ...errors import DockerError, UserError
from ...plan.compose import PROJECT
from ...plan.machines import VARIABLE
from .reach import Daemon

LABEL = "org.mqttxt.testbed"
PORT = 2377
CLEAR = f"docker swarm leave --force; docker rm -f $(docker ps -aqf name={PROJECT})"
"""What ends the fleet of a machine that is alive, and was out of reach."""
GATEWAY_BRIDGE = "docker_gwbridge"
"""What Docker makes of itself with a swarm, and does not remove."""
NONE, ACTIVE = "inactive", "active"
MARKED_S, POLL_S = 10.0, 0.2
"""Within which a node can be given its label: none can while the swarm itself changes what it knows of the node."""


@contextlib.contextmanager
def joined(here: Any, daemons: Sequence[Daemon]) -> Iterator[dict[str, str]]:
    """This machine's Docker (`here`) manages a swarm that all others are in, for as long as this lasts.

    Yields by machine the id of its node in the swarm.

    Raises UserError for a machine that is in another swarm, or cannot join.
    """
    asked: set[str] = set()
    try:
        _make(here)
        yield {daemon.name: _join(here, daemon, asked) for daemon in daemons}
    finally:
        _leave(here, daemons, asked)


def _make(here: Any) -> None:
    found = here.info()["Swarm"]
    if found["LocalNodeState"] == NONE:
        try:
            here.swarm.init(labels={LABEL: "made"})
        except APIError as error:
            said = error.explanation or str(error)
            raise UserError(f"{VARIABLE}: no swarm can be made here: {said}; docker swarm init makes one") from error
    elif found["LocalNodeState"] != ACTIVE or not found["ControlAvailable"]:
        raise UserError(f"{VARIABLE}: expected this machine in no swarm, or as a manager of one (docker swarm leave)")


def forget(here: Any, node_id: str) -> None:
    """A machine that is lost holds no overlay any more; one that was in the swarm before the run stays in it."""
    with contextlib.suppress(NotFound):
        node = here.nodes.get(node_id)
        if LABEL in node.attrs["Spec"].get("Labels", {}):
            node.remove(force=True)


def _join(here: Any, daemon: Daemon, asked: set[str]) -> str:
    """The id of a machine's node. Who was in no swarm is among those `asked` before it can be in this one."""
    where = f"{VARIABLE}: {daemon.machine.address}"
    found = daemon.client.info()["Swarm"]
    if found["LocalNodeState"] == NONE:
        address = here.info()["Swarm"]["NodeAddr"]
        asked.add(daemon.name)
        try:
            daemon.client.swarm.join([f"{address}:{PORT}"], here.swarm.attrs["JoinTokens"]["Worker"])
        except (APIError, RequestException) as error:
            said = getattr(error, "explanation", None) or error
            expected = f"a machine that reaches TCP port {PORT} of {address}"
            raise UserError(f"{where}: {said}: expected {expected}") from error
        node_id = str(daemon.client.info()["Swarm"]["NodeID"])
        _mark(here, daemon, node_id)
        return node_id
    if found["NodeID"] not in {node.id for node in here.nodes.list()}:
        raise UserError(f"{where}: is in another swarm: expected none, or this machine's (docker swarm leave)")
    return str(found["NodeID"])


def _mark(here: Any, daemon: Daemon, node_id: str) -> None:
    """Give a node its label. Raises DockerError naming the machine."""
    deadline_s = time.monotonic() + MARKED_S
    while True:
        try:
            node = here.nodes.get(node_id)
            spec = node.attrs["Spec"]
            node.update({**spec, "Labels": {**spec.get("Labels", {}), LABEL: "joined"}})
        except APIError as error:
            if time.monotonic() > deadline_s:
                raise DockerError(f"{daemon.name}: its node cannot be labelled: {error.explanation}") from error
            time.sleep(POLL_S)
        else:
            return


def _leave(here: Any, daemons: Sequence[Daemon], asked: set[str]) -> None:
    """Take apart what was made: who was `asked` leaves, though it was interrupted, and who a killed run had asked.

    Of a swarm that is not this machine's nobody leaves. Raises DockerError naming the machines that do not answer.
    """
    found = here.info()["Swarm"]
    if found["LocalNodeState"] != ACTIVE or not found["ControlAvailable"]:
        return
    is_ours = LABEL in here.swarm.attrs["Spec"].get("Labels", {})
    nodes = {node.id: node for node in here.nodes.list()}
    left = []
    for daemon in daemons:
        try:
            there = daemon.client.info()["Swarm"]
            node = nodes.get(there.get("NodeID"))
            is_known = node is not None and (is_ours or LABEL in node.attrs["Spec"].get("Labels", {}))
            if there["LocalNodeState"] != NONE and (is_known or daemon.name in asked):
                daemon.client.swarm.leave(force=True)
                _remove_bridge(daemon.client)
                if node is not None:
                    node.remove(force=True)
        except (APIError, RequestException):
            if daemon.name in asked:  # another one may be in a swarm of its own
                left.append(daemon.name)
    if is_ours:
        here.swarm.leave(force=True)
        _remove_bridge(here)
    if left:
        raise DockerError(f"{', '.join(left)}: does not answer; type there: {CLEAR}")


def _remove_bridge(client: Any) -> None:
    """Where containers that are not ours are at it, it stays."""
    with contextlib.suppress(NotFound):
        bridge = client.networks.get(GATEWAY_BRIDGE)
        if not bridge.attrs["Containers"]:
            bridge.remove()
