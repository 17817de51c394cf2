"""Long tests run only when one of their sources has changed since they passed.

A test marked `soak` names the files and folders that it tests. When it has passed, a hash of them is kept in PASSED,
which belongs to the repository. While the hash is the same, `make test` and `make soak` leave the test out and say so.
`make soak ALL=1` runs every one. One that is marked `too_long`, too, is run by `make soak` alone.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Generator
from pathlib import Path

import pytest
from xdist import is_xdist_worker

MARK = "soak"
PASSED = Path(__file__).with_suffix(".json")
UNCHANGED = "nothing that it tests has changed since it passed"
TOO_LONG = "it takes longer than make test may; make soak runs it"
_DIGEST = pytest.StashKey[str]()
_reports: dict[str, list[pytest.TestReport]] = {}


def digest_of(root: Path, sources: tuple[str, ...]) -> str:
    """A hash of the names and contents of all files. Raises FileNotFoundError for a missing source."""
    whole = hashlib.sha256()
    for source in sources:
        path = root / source
        files = sorted(path.rglob("*")) if path.is_dir() else [path]
        for file in files:
            if file.is_dir() or any(part == "__pycache__" or part.endswith(".egg-info") for part in file.parts):
                continue
            content = hashlib.sha256(file.read_bytes()).hexdigest()
            whole.update(f"{file.relative_to(root)} {content}\n".encode())
    return whole.hexdigest()


def _name(item: pytest.Item) -> str:
    """A test's name without its parameters."""
    return item.nodeid.partition("[")[0]


def _passed() -> dict[str, str]:
    found: dict[str, str] = json.loads(PASSED.read_text()) if PASSED.exists() else {}
    return found


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--soak-all", action="store_true", help="run long tests though nothing that they test has changed")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    passed, digests = _passed(), dict[tuple[str, ...], str]()
    for item in items:
        mark = item.get_closest_marker(MARK)
        if mark is None:
            continue
        sources = (str(item.path.relative_to(config.rootpath)), *mark.args)
        if sources not in digests:
            digests[sources] = digest_of(config.rootpath, sources)
        item.stash[_DIGEST] = digests[sources]
        if passed.get(_name(item)) == digests[sources] and not config.option.soak_all:
            item.add_marker(pytest.mark.skip(reason=UNCHANGED))
        elif mark.kwargs.get("too_long") and config.option.markexpr != MARK:
            item.add_marker(pytest.mark.skip(reason=TOO_LONG))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    if _DIGEST in item.stash:
        report.soak = (_name(item), item.stash[_DIGEST])
    return report


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    if hasattr(report, "soak"):
        _reports.setdefault(report.soak[0], []).append(report)


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    """Record the tests that passed, if tests were run with all their parameters."""
    config = session.config
    was_ended = exitstatus == pytest.ExitCode.INTERRUPTED or session.shouldfail or session.shouldstop
    is_part = config.option.keyword or config.option.markexpr not in ("", MARK) or any("[" in a for a in config.args)
    if is_xdist_worker(session) or was_ended or is_part:
        return
    passed = _passed()
    for name in _reports:
        if _is_left_out(_reports[name]):
            continue
        passed.pop(name, None)
        if all(report.passed for report in _reports[name]):
            passed[name] = _reports[name][0].soak[1]
    PASSED.write_text(json.dumps(passed, indent=2, sort_keys=True) + "\n")


def _is_left_out(reports: list[pytest.TestReport]) -> bool:
    return _why_left_out(reports) is not None


def _why_left_out(reports: list[pytest.TestReport]) -> str | None:
    said = " ".join(str(report.longrepr) for report in reports if report.skipped)
    return next((why for why in (UNCHANGED, TOO_LONG) if why in said), None)


@pytest.hookimpl(wrapper=True)
def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> Generator[None, None, None]:
    """Print a line for each test that was left out, after everything else."""
    yield
    for name, reports in sorted(_reports.items()):
        if (why := _why_left_out(reports)) is not None:
            terminalreporter.line(f"NOT RUN {name}: {why}", yellow=True)
