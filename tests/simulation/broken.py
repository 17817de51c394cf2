"""Roles with one rule of the signed mode taken away: a test by adversaries proves its worth by finding them.

`python -m tests.simulation.broken VARIANT uav OPTIONS…` starts one as a process; `none` takes nothing away.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from mqttxt.core.clock import MAX_TTL_MS
from mqttxt.core.ledger import Admission
from mqttxt.drone.role import UavClient
from mqttxt.errors import PayloadError
from mqttxt.protocol.codec import decode, encode
from mqttxt.protocol.messages import CommandMessage, ResultMessage
from mqttxt.security.seal import Signed, is_station
from mqttxt.station.role import StationRole
from tests.simulation.adversary import Dangers
from tests.simulation.drone_node import DroneNode
from tests.simulation.hostile import HostileSimulation, SignedJudge, signed_payload
from tests.simulation.nodes import DRONES, StationNode


class Found(Exception):
    """The judge found a violation; the text has its kind."""


class _Finder(SignedJudge):
    def _blame(self, kind: str, sentence: str) -> None:
        raise Found(f"{kind}: {sentence}")


class _BrokenDrone(DroneNode):
    def make_role(self) -> UavClient:
        role = super().make_role()
        assert isinstance(self.sim, BrokenSimulation)
        BROKEN.get(self.sim.variant, _sound)(role)
        return role


class _BrokenStation(StationNode):
    def make_role(self) -> StationRole:
        role = super().make_role()
        assert isinstance(self.sim, BrokenSimulation)
        BROKEN_STATIONS.get(self.sim.variant, _sound)(role)
        return role


class BrokenSimulation(HostileSimulation):
    """A hostile history of a broken role; it ends with Found at the first violation."""

    def __init__(self, seed: int, dangers: Dangers, rate: float, variant: str, thief: bool = False) -> None:
        self.variant = variant
        super().__init__(seed, dangers, rate, thief)

    def make_judge(self) -> SignedJudge:
        return _Finder(self.events)

    def make_drone(self, number: int) -> DroneNode:
        return _BrokenDrone(self, number)

    def make_station(self) -> StationNode:
        return _BrokenStation(self, "station")


def verifies_nothing(role: UavClient) -> None:
    """It looks up an expected signer's certificate, but does not check the signature."""
    seal = _seal(role)
    genuine = seal.verified

    def verified(envelope: Any, topic: Any, expected: Any) -> Signed:
        try:
            return genuine(envelope, topic, expected)
        except PayloadError:
            known = [each for among in seal._known.values() for each in among if expected(each)]
            if not known:
                raise
            return Signed(known[0], envelope)

    seal.verified = verified


def executes_again(role: UavClient) -> None:
    """It forgets an id once that has its last word."""
    ledger: Any = role.desk.ledger
    genuine = ledger.examine

    def examine(command_id: Any, *more: Any) -> Admission:
        entry = ledger.get(command_id)
        if entry is not None and entry.record.last is not None:
            return Admission.NEW
        return genuine(command_id, *more)

    ledger.examine = examine


def believes_the_topic(role: UavClient) -> None:
    """It takes every command on its topic, whichever drone and session that was signed for."""
    seal, desk, own = _seal(role), _desk(role), role.session
    genuine = desk._opened

    def open_of_station(topic: str, envelope: Any) -> Signed:
        drones = (f"drone{number}/{topic.partition('/')[2]}" for number in DRONES)
        refusal: PayloadError | None = None
        for signed_as in drones:
            try:
                return seal.verified(envelope, lambda _, signed_as=signed_as: signed_as, is_station)
            except PayloadError as error:
                refusal = error
        assert refusal is not None
        raise refusal

    def opened(message: Any) -> Any:
        payload, signed = genuine(message)
        return encode(replace(decode(CommandMessage, payload), executor_session=own)), signed

    seal.open_of_station = open_of_station
    desk._opened = opened


def believes_the_route(role: UavClient) -> None:
    """It goes by the deadline beside the signed payload."""

    def tightened(command: Any, route: Any) -> Any:
        return command if type(route) is not int else replace(command, deadline_ms=route)

    _desk(role)._tightened = tightened


def has_no_deadlines(role: UavClient) -> None:
    """It takes every command as due a minute from now, at its start and at each write."""
    desk = _desk(role)
    genuine = desk._on_command

    def on_command(command: Any, retained: bool, now_ms: int, *more: Any) -> Any:
        return genuine(replace(command, deadline_ms=now_ms + MAX_TTL_MS), retained, now_ms, *more)

    desk._on_command = on_command


def believes_any_word(role: StationRole) -> None:
    """A ground station that takes every word for its drone's."""

    def believed(fog: Any, topic: Any, message: Any) -> tuple[ResultMessage, str]:
        return decode(ResultMessage, signed_payload(message.payload)), f"drone{topic.drone}"

    words: Any = role._words
    words.result = believed


BROKEN: dict[str, Callable[[UavClient], None]] = {
    each.__name__: each
    for each in (verifies_nothing, executes_again, believes_the_topic, believes_the_route, has_no_deadlines)
}


BROKEN_STATIONS: dict[str, Callable[[StationRole], None]] = {believes_any_word.__name__: believes_any_word}


def _sound(role: object) -> None: ...


def _desk(role: UavClient) -> Any:
    return role.desk


def _seal(role: UavClient) -> Any:
    seal = role._channel.seal
    assert seal is not None
    return seal


def break_all(breaks: Callable[[UavClient], None]) -> None:
    """Break every UAV client that this process makes from now on."""
    made: Any = UavClient
    genuine = made.__init__

    def broken(role: UavClient, *arguments: Any, **options: Any) -> None:
        genuine(role, *arguments, **options)
        breaks(role)

    made.__init__ = broken


if __name__ == "__main__":
    from mqttxt.cli import main

    variant = sys.argv.pop(1)
    if variant != "none":
        break_all(BROKEN[variant])
    main()
