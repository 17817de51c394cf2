"""A pytest within pytest has nothing of the outer one's options."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.rigs.inner_pytest import run_pytest

OUTER = {
    "PYTEST_ADDOPTS": "--no-such-option",
    "PYTEST_XDIST_WORKER": "gw7",
    "PYTEST_XDIST_WORKER_COUNT": "8",
    "PYTEST_XDIST_TESTRUNUID": "7",
}
TEST = "import os\n\ndef test_it():\n    assert not [name for name in os.environ if name.startswith('PYTEST_XDIST')]\n"


@pytest.mark.long
@pytest.mark.timeout(600)  # it takes a second, on a busy machine minutes
def test_the_outer_ones_options_and_worker_are_not_the_inner_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in OUTER.items():
        monkeypatch.setenv(name, value)
    (tmp_path / "test_it.py").write_text(TEST)
    assert "1 passed" in run_pytest(tmp_path).stdout
