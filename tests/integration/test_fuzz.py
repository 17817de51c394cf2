"""Fuzzing at length: the codecs by coverage, the roles with ten times the cases of the unit tests."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.rigs.inner_pytest import inner_environment
from tests.rigs.processes import ROOT

pytestmark = [pytest.mark.integration, pytest.mark.apart, pytest.mark.timeout(420)]

CODEC_RUNS = 100_000
ROLE_EXAMPLES = 300


def _output(command: list[str], **environment: str) -> str:
    done = subprocess.run(
        command,
        cwd=ROOT,
        env=inner_environment(**environment),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        timeout=400,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-4000:]
    return done.stdout


@pytest.mark.soak(
    *("services/mqttxt/src/mqttxt/protocol", "services/mqttxt/src/mqttxt/errors.py", "spec"),
    *("tests/fuzz", "requirements/testbed.txt"),
)
def test_no_bytes_get_anything_but_a_message_or_a_reason_out_of_the_codecs(tmp_path: Path) -> None:
    pytest.importorskip("atheris", reason="atheris has no wheel for this platform and Python")
    target = str(ROOT / "tests" / "fuzz" / "fuzz_codec.py")
    options = [f"-runs={CODEC_RUNS}", "-seed=1", "-max_len=400", "-use_value_profile=1"]
    said = _output([sys.executable, target, str(tmp_path), *options])
    assert f"Done {CODEC_RUNS} runs" in said


@pytest.mark.soak(
    *(f"services/mqttxt/src/mqttxt/{name}" for name in ("activator", "core", "drone", "protocol", "station")),
    *("tests/unit/mqttxt/test_fuzz_roles.py", "tests/simulation/strategies.py", "tests/simulation/world.py"),
)
def test_roles_stand_ten_times_as_much(tmp_path: Path) -> None:
    tests = "tests/unit/mqttxt/test_fuzz_roles.py"
    options = ["-q", "-p", "no:cacheprovider", "--timeout=380"]
    said = _output([sys.executable, "-m", "pytest", *options, tests], FUZZ_EXAMPLES=str(ROLE_EXAMPLES))
    assert " passed" in said
