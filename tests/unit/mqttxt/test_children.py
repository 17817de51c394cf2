"""A child that ends with this process, where the kernel does not see to it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(sys.platform != "linux" or os.geteuid() != 0, reason="root's guard on Linux")
WITH_A_CHILD = """
import asyncio, os, signal
from mqttxt.core.children import ending_with_parent

async def main():
    child = await asyncio.create_subprocess_exec("sleep", "600", start_new_session=True)
    stop = asyncio.Event()
    asyncio.get_running_loop().add_signal_handler(signal.SIGINT, stop.set)
    async with ending_with_parent(child.pid):
        print(child.pid, flush=True)
        await stop.wait()
    print(child.returncode, flush=True)
    child.kill()
    await child.wait()

asyncio.run(main())
"""


@pytest.fixture
def parent() -> subprocess.Popen[str]:
    """As in a terminal: it and what it starts are one process group."""
    command = [sys.executable, "-c", WITH_A_CHILD]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True)


def test_ctrl_c_in_a_terminal_ends_the_guard_no_sooner_than_its_parent(parent: subprocess.Popen[str]) -> None:
    assert parent.stdout is not None
    child = int(parent.stdout.readline())
    started = Path(f"/proc/{parent.pid}/task/{parent.pid}/children").read_text().split()
    (guard,) = [int(pid) for pid in started if int(pid) != child]
    assert os.getsid(guard) != os.getsid(parent.pid)
    os.killpg(parent.pid, signal.SIGINT)
    assert parent.stdout.read() == "None\n"
    assert parent.wait(30) == 0


def test_a_killed_parent_takes_its_child_with_it(parent: subprocess.Popen[str]) -> None:
    assert parent.stdout is not None
    parent.stdout.readline()
    parent.kill()
    parent.wait(30)
    assert parent.stdout.read() == ""  # the child had it too
