"""The cost of signing in processor time: a command's way through all three roles without sockets, and its parts."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable
from statistics import median

from mqttxt.protocol.commands import Mavlink
from tests.simulation.signing import seal
from tests.simulation.world import World, ack

COMMANDS, WARM_UP = 300, 20
REPEATED, ROUNDS = 200, 9
CHANGE_SPEED = 178
_TOPIC, _PAYLOAD = "drone1/commands", bytes(40)


def measure() -> list[str]:
    """Lines of figures; takes a few seconds. Other programs' time on a busy machine does not count."""
    station, drone = seal("gs-g"), seal("drone1")
    drone.open(_TOPIC, station.sign(_TOPIC, _PAYLOAD, with_certificate=True).encode(), station.name)
    said = station.sign(_TOPIC, _PAYLOAD).encode()
    key = station.certificate.public_key
    covered = b"Signature1" + bytes(120)
    own = station.identity.sign(covered)
    parts = {
        "a message signed": lambda: station.sign(_TOPIC, _PAYLOAD).encode(),
        "Ed25519 of that": lambda: station.identity.sign(covered),
        "a message verified": lambda: drone.open(_TOPIC, said, station.name),
        "Ed25519 of it": lambda: key.verify(own, covered),
    }
    figures = ", ".join(f"{what} {_least_us(act):.0f}" for what, act in parts.items())
    plain, secured = _whole_way_us()
    return [
        f"signing: processor time of a command from its call to its write, all three roles, median of {COMMANDS} in "
        f"turns: plain {plain:.0f} us, signed {secured:.0f} us, {secured - plain:+.0f}",
        f"signing: processor time in us, the least of {ROUNDS} rounds: {figures}",
    ]


def _least_us(act: Callable[[], object]) -> float:
    took = []
    for _ in range(ROUNDS):
        before = time.process_time_ns()
        for _ in range(REPEATED):
            act()
        took.append((time.process_time_ns() - before) / REPEATED / 1000)
    return min(took)


def _whole_way_us() -> tuple[float, float]:
    worlds = [World(signed=how).start() for how in (False, True)]
    took: list[list[float]] = [[], []]
    for world in worlds:
        world.pass_time(3000)
    gc.disable()
    for turn in range(WARM_UP + COMMANDS):
        for world, found in zip(worlds, took, strict=True):
            before = time.process_time_ns()
            world.send(Mavlink(CHANGE_SPEED, (1, 5, -1, 0, 0, 0, 0)))
            if turn >= WARM_UP:
                found.append((time.process_time_ns() - before) / 1000)
            assert len(world.wrote) == turn + 1
            world.autopilot(ack(CHANGE_SPEED))
            world.pass_time(200)
            world.sent.clear()
    gc.enable()
    return median(took[0]), median(took[1])
