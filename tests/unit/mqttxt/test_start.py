"""What is loaded at a start: a command's help needs no broker, no autopilot and no table; a station no autopilot."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

import mqttxt

pytestmark = pytest.mark.long

HEAVY = (
    *("asyncio", "ssl", "paho", "pymavlink", "rich", "cryptography", "numpy"),
    *("mqttxt_conformance", "mqttxt.station.process"),
)
COMMAND = """
import json, sys
from mqttxt.cli import main
sys.argv = ["mqttxt", *{arguments!r}]
try:
    main()
except SystemExit as end:
    print(json.dumps([end.code, sorted(sys.modules)]))
"""


def loaded(program: str) -> tuple[int, set[str], str]:
    """A program's last line: its exit code and modules; and what it printed before that."""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    *said, last = done.stdout.splitlines()
    code, modules = json.loads(last)
    return code, set(modules), "\n".join(said)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [(["--version"], f"mqttxt {mqttxt.__version__}"), (["--help"], "conformance"), (["gs", "--help"], "watch")],
)
def test_version_and_help_load_nothing_heavy(arguments: list[str], said: str) -> None:
    code, modules, text = loaded(COMMAND.format(arguments=arguments))
    assert code == 0
    assert said in text
    assert modules.isdisjoint(HEAVY)


def test_a_ground_station_loads_no_autopilots_dialect_and_without_an_identity_no_cryptography() -> None:
    program = (
        "import json, sys\nfrom mqttxt import GroundStation\nGroundStation('mqtt://127.0.0.1')\n"
        "print(json.dumps([0, sorted(sys.modules)]))"
    )
    _, modules, _ = loaded(program)
    assert "mqttxt.station.process" in modules
    assert modules.isdisjoint({"cryptography", "pymavlink", "rich", "typer", "mqttxt.activator", "mqttxt.drone"})


def test_every_public_name_is_found_where_it_is_first_asked_for() -> None:
    assert set(mqttxt.__all__) <= set(dir(mqttxt))
    assert all(getattr(mqttxt, name) is not None for name in mqttxt.__all__)
    with pytest.raises(AttributeError, match="module 'mqttxt' has no attribute 'Runner'"):
        mqttxt.Runner  # noqa: B018
