"""A node's routers: what they are told, whom they have heard, and that the node ends when one of them does."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
from typer.testing import CliRunner

from router.__main__ import app
from router.chains import ChainError, Router, parse_drones, read_chain
from router.heard import Heard
from router.process import Node, Turn
from tests.rigs.processes import eventually

PER_UAV = "udps:0.0.0.0:14541 udpc:h:14541 --hb-systemid=221\nudps:0.0.0.0:14542 udpc:h:14542 --hb-systemid=222\n"
SHARED = "udps:0.0.0.0:14540 udpc:h:14540 --hb-systemid=221\n"
APPEARED = "2026/01/01 10:00:00 node appeared: chan=udp:127.0.0.1:14580 sid=3 cid=1"
GONE = APPEARED.replace("appeared", "disappeared")
STARTED = "2026/01/01 10:00:00 router started with 2 endpoints"
AT_ONCE = Turn(None, None)


def test_a_chain_per_uav_has_a_router_a_drone() -> None:
    routers = read_chain("per-uav", (1, 2), {"PER_UAV": PER_UAV, "SHARED": SHARED})
    assert [(router.name, router.drones, router.arguments[-1]) for router in routers] == [
        ("uav1", (1,), "--hb-systemid=221"),
        ("uav2", (2,), "--hb-systemid=222"),
    ]


def test_a_shared_chain_has_one_router_for_all_and_a_direct_one_none() -> None:
    (router,) = read_chain("shared", (1, 2), {"PER_UAV": PER_UAV, "SHARED": SHARED})
    assert (router.name, router.drones) == ("all", (1, 2))
    assert read_chain("direct", (1, 2), {}) == ()


def test_drones_that_do_not_fly_have_no_router_and_nobody_waits_for_them() -> None:
    (router,) = read_chain("per-uav", (1, 2), {"PER_UAV": PER_UAV}, only=(1,))
    assert (router.drones, router.arguments[-1]) == ((1,), "--hb-systemid=221")
    (shared,) = read_chain("shared", (1, 2), {"SHARED": SHARED}, only=(1,))
    assert shared.drones == (1,)


@pytest.mark.parametrize(
    ("chain", "said"),
    [
        ("star", "--chain 'star': expected one of per-uav, shared, direct"),
        ("shared", "SHARED: 0 lines, expected 1: mavp2p's arguments, a router a line"),
        ("per-uav", "PER_UAV: 2 lines, expected 3: mavp2p's arguments, a router a line"),
    ],
)
def test_a_chain_that_cannot_be_run_is_named(chain: str, said: str) -> None:
    with pytest.raises(ChainError) as error:
        read_chain(chain, (1, 2, 3), {"PER_UAV": PER_UAV})
    assert str(error.value) == said


@pytest.mark.parametrize("text", ["", "1,", "0", "251", "one"])
def test_drones_are_system_ids(text: str) -> None:
    with pytest.raises(ChainError, match="expected system ids from 1 to 250"):
        parse_drones(text)


def test_an_autopilot_is_heard_until_its_channel_is_gone() -> None:
    heard = Heard()
    assert not heard.has((3,))
    heard.line(APPEARED)
    assert heard.has((3,))
    assert not heard.has((3, 4))
    heard.line(GONE)
    assert not heard.has((3,))


def test_an_autopilot_that_moved_to_another_channel_is_still_heard() -> None:
    heard = Heard()
    for line in (APPEARED, APPEARED.replace("14580", "14599"), GONE):
        heard.line(line)
    assert heard.has((3,))


def test_other_components_and_routers_are_no_autopilots() -> None:
    heard = Heard()
    heard.line(APPEARED.replace("cid=1", "cid=191"))
    assert not heard.has((3,))


@pytest.mark.parametrize(
    "line",
    [
        "2026/01/01 10:00:0{} Warning: received message addressed to unexistent node with systemID=3 and componentID=1",
        "2026/01/01 10:00:0{} channel opened: udp:127.0.0.1:14541",
        "2026/01/01 10:00:0{0} channel closed: udp:127.0.0.1:14541, read udp4 127.0.0.1:3000{0}->127.0.0.1:14541: no",
    ],
)
def test_what_repeats_is_shown_once(line: str) -> None:
    heard = Heard()
    assert [heard.line(line.format(i)) for i in range(3)] == [True, False, False]
    assert heard.line(line.format(3).replace("14541", "14542").replace("systemID=3", "systemID=4"))


def program(folder: Path, text: str) -> str:
    path = folder / "mavp2p"
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)
    return str(path)


async def test_the_node_ends_with_the_reason_when_a_router_ends(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    routers = (Router(("a",), (1,)), Router(("b",), (2,)))
    fails = program(tmp_path, 'if [ $1 = b ]; then echo "ERR: address in use"; exit 3; fi; exec sleep 60')
    async with asyncio.timeout(30):
        said = await Node(fails, routers, tmp_path / "ready", AT_ONCE).run()
    assert said == "mavp2p b ended with code 3; its last words: ERR: address in use"
    assert "uav2: ERR: address in use" in capsys.readouterr().out
    assert not (tmp_path / "ready").exists()


async def test_it_is_ready_once_every_router_has_heard_its_autopilots(tmp_path: Path) -> None:
    speaks = program(tmp_path, f'echo "{APPEARED}"; exec sleep 60')
    node = asyncio.create_task(Node(speaks, (Router((), (3,)),), tmp_path / "ready", AT_ONCE).run())
    await eventually((tmp_path / "ready").exists, "ready")
    await end(node)


def test_it_listens_from_when_it_says_so() -> None:
    heard = Heard()
    heard.line("2026/01/01 10:00:00 mavp2p v0.0.0")
    assert not heard.listening
    heard.line(STARTED)
    assert heard.listening


async def end(node: asyncio.Task[str]) -> None:
    node.cancel()
    with pytest.raises(asyncio.CancelledError):
        await node


async def test_its_routers_start_when_the_next_node_says_that_its_own_listen(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    speaks = program(tmp_path, f'touch {tmp_path}/$1; echo "{STARTED}"; exec sleep 60')
    turn = Turn(after=tmp_path / "cloud", listening=tmp_path / "fog1")
    node = asyncio.create_task(Node(speaks, (Router(("a",), (1,)),), tmp_path / "ready", turn).run())
    await eventually(lambda: "waiting for" in capsys.readouterr().out, "it waits for the next node")
    assert not (tmp_path / "a").exists()
    (tmp_path / "cloud").touch()
    await eventually((tmp_path / "fog1").exists, "fog1")
    assert (tmp_path / "a").exists()
    await end(node)
    assert not (tmp_path / "fog1").exists()


async def test_a_node_listens_when_the_last_of_its_routers_does(tmp_path: Path) -> None:
    slow = f"[ $1 = a ] || until [ -e {tmp_path}/go ]; do sleep 0.02; done"
    speaks = program(tmp_path, f'{slow}; echo "{STARTED}"; echo "{APPEARED}"; exec sleep 60')
    routers = (Router(("a",), (3,)), Router(("b",), ()))
    turn = Turn(None, tmp_path / "gs")
    node = asyncio.create_task(Node(speaks, routers, tmp_path / "ready", turn).run())
    await eventually((tmp_path / "ready").exists, "ready")
    assert not (tmp_path / "gs").exists()
    (tmp_path / "go").touch()
    await eventually((tmp_path / "gs").exists, "gs")
    await end(node)


async def test_a_direct_chain_has_nothing_to_wait_with(tmp_path: Path) -> None:
    node = asyncio.create_task(Node("mavp2p", (), tmp_path / "ready", Turn(None, tmp_path / "gs")).run())
    await eventually((tmp_path / "gs").exists, "gs")
    await end(node)


@pytest.mark.parametrize("routers", [(), (Router((), (3,)),)])
async def test_where_it_cannot_say_so_that_is_named(tmp_path: Path, routers: tuple[Router, ...]) -> None:
    speaks = program(tmp_path, f'echo "{STARTED}"; exec sleep 60')
    node = Node(speaks, routers, tmp_path / "ready", Turn(None, tmp_path / "no" / "gs"))
    async with asyncio.timeout(30):
        assert await node.run() == f"--listening {tmp_path}/no/gs: No such file or directory"


async def test_a_program_that_is_not_there_is_named(tmp_path: Path) -> None:
    node = Node(str(tmp_path / "nothing"), (Router((), (3,)),), tmp_path / "ready", AT_ONCE)
    assert await node.run() == f"{tmp_path}/nothing: No such file or directory"


def test_bad_options_are_one_line_and_exit_code_2() -> None:
    done = CliRunner().invoke(app, ["--chain", "star", "--drones", "1", "--ready-file", "/nowhere/ready"])
    assert done.exit_code == 2
    assert done.output == "router: --chain 'star': expected one of per-uav, shared, direct\n"
