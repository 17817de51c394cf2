"""Settings for all tests; how they share a machine is in `workers`, `lateness` and `soak`."""

from __future__ import annotations

import gc
import os
from collections.abc import Generator
from functools import cache

import pytest
from hypothesis import HealthCheck, settings
from typer import testing

pytest_plugins = ("tests.lateness", "tests.soak", "tests.workers")

# An example's duration depends on the machine's load. The quick check tries a tenth of them (`examples`).
settings.register_profile("any machine", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("quick", settings.get_profile("any machine"), max_examples=10)
settings.load_profile("any machine")

# A typer runner builds a program's tree of options for each command that it runs, which takes longer than most do.
testing._get_command = cache(testing._get_command)


@pytest.fixture(autouse=True, scope="session")
def _own_state(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Keep a UAV client's default journal out of the home folder of the person who runs the tests."""
    os.environ["XDG_STATE_HOME"] = str(tmp_path_factory.mktemp("state"))


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Exclude the collected tests from garbage collection, during the collection and after: they stay to the end."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


class Failures:
    """Reports failures at once: an interrupted run prints no summary."""

    def __init__(self, config: pytest.Config) -> None:
        self._config = config

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        terminal = self._config.pluginmanager.get_plugin("terminalreporter")
        if report.failed and terminal is not None:
            said = report.longreprtext.rstrip().splitlines() or [""]
            reasons = [line.removeprefix("E").strip() for line in said if line.startswith("E ")]
            terminal.write_line(f"{report.when} of {report.nodeid} failed: {(reasons or said[-1:])[0][:300]}")


def pytest_configure(config: pytest.Config) -> None:
    if not hasattr(config, "workerinput"):
        config.pluginmanager.register(Failures(config))
