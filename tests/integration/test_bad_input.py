"""What is wrong on the wire never ends a process; what is wrong with a broker or a fog is one line."""

from __future__ import annotations

import random
import socket
import subprocess
from pathlib import Path

import cbor2
import pytest

from mqttxt import GroundStation
from tests.rigs import prefork
from tests.rigs.plain_client import plain_client
from tests.rigs.processes import Broker, System, eventually

pytestmark = [pytest.mark.integration, pytest.mark.apart]

GARBAGE_EACH = 40


def _garbage(seed: int) -> list[bytes]:
    chance = random.Random(seed)
    return [
        b"",
        b"{",
        b"\xff" * 50,
        b'{"version":2}',
        cbor2.dumps([1, 2, 3]),
        cbor2.dumps({"a": float("nan")}),
        b"\x9f" * 20_000,
        *(chance.randbytes(chance.randint(1, 60)) for _ in range(GARBAGE_EACH)),
    ]


async def test_garbage_on_every_topic_ends_nothing_and_is_answered_where_an_answer_is_due(system: System) -> None:
    rests = ("init_connect", "commands", "drone1/commands", "drone1/reachable", "reachable", "clock", "drone1/nothing")
    below = ("drone1/commands", "drone1/init_connect", "drone1/reachable", "drone1/clock", "drone1/state/battery")
    with plain_client(system.cloud.port) as cloud, plain_client(system.fog.port) as fog_broker:
        for number, garbage in enumerate(_garbage(1)):
            for rest in rests:
                cloud.publish(f"fog1/{rest}", garbage, qos=number % 2)
            for rest in (*below, "drone1/state/x", "drone1/commands_result/arm", "drone999/clock", "x/reachable"):
                fog_broker.publish(rest, garbage, qos=number % 2)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            for garbage in _garbage(2):
                sock.sendto(garbage[:1000], ("127.0.0.1", system.autopilots[1]))

        async with GroundStation(system.cloud.url) as station:
            (fog,) = await station.connect([1])
            await eventually(lambda: fog.drone(1).is_reachable, "drone 1 is (again) reachable")
            assert (await fog.drone(1).arm()).completed
    assert [process.exit_code for process in (system.activator, *system.uavs.values())] == [None] * 3
    for process in (system.activator, system.uavs[1]):
        warnings = [line for line in process.log.read_text().splitlines() if "further ones are counted" in line]
        kinds = [line.split("mqttxt: ")[1].split(":")[0] for line in warnings]
        assert "malformed" in kinds
        assert len(kinds) == len(set(kinds)), "each kind is logged once"


def _run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return prefork.run("mqttxt", *arguments)


def _last_line(done: subprocess.CompletedProcess[str]) -> str:
    assert "Traceback" not in done.stderr
    return done.stderr.strip().splitlines()[-1]


def test_a_broker_that_refuses_is_one_line(tmp_path: Path) -> None:
    locked = Broker(tmp_path, "locked")
    text = locked.configuration.read_text().replace("allow_anonymous true", "allow_anonymous false")
    locked.configuration.write_text(text)
    locked.start()
    try:
        done = _run("gs", "send", "arm", "--cloud", locked.url)
    finally:
        locked.kill()
    assert done.returncode == 1
    assert f"mqtt://127.0.0.1:{locked.port} refused the connection with reason code 0x87" in _last_line(done)


def test_a_fog_that_does_not_answer_is_one_line(broker: Broker) -> None:
    done = _run("gs", "send", "arm", "--fog", "9", "--cloud", broker.url, "--timeout", "5")
    assert done.returncode == 1
    found = f"mqttxt: fog 9: no activator is at {broker.url} (waited 5 s); expected --cloud (or MQTTXT_CLOUD) and --fog"
    assert _last_line(done) == f"{found} of a running fleet"
