"""What passed is written down, and left out until what it tests has changed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests import soak
from tests.rigs.inner_pytest import run_pytest

pytestmark = pytest.mark.timeout(600)  # a pytest within pytest takes seconds, on a busy machine minutes
TESTS = """
from pathlib import Path
import pytest

@pytest.mark.soak("product")
@pytest.mark.parametrize("n", range(2))
def test_long(n):
    assert (Path(__file__).parent / "product" / "module.py").read_text() != "broken"

@pytest.mark.soak("other.py")
def test_other():
    pass

def test_quick():
    pass
"""
CONFIGURATION = '[tool.pytest.ini_options]\nmarkers = ["soak(sources, too_long=False): a"]\ntestpaths = ["."]\n'


@pytest.fixture
def project(tmp_path: Path) -> Path:
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "__init__.py").touch()
    (tmp_path / "tests" / "soak.py").write_text(Path(soak.__file__).read_text())
    (tmp_path / "conftest.py").write_text('pytest_plugins = ["tests.soak"]\n')
    (tmp_path / "pyproject.toml").write_text(CONFIGURATION)
    (tmp_path / "test_it.py").write_text(TESTS)
    (tmp_path / "other.py").write_text("")
    (tmp_path / "product").mkdir()
    (tmp_path / "product" / "module.py").write_text("sound")
    return tmp_path


def run(project: Path, *words: str) -> list[str]:
    return run_pytest(project, *words).stdout.splitlines()


def not_run(lines: list[str]) -> list[str]:
    return [line.split()[2].removesuffix(":") for line in lines if line.startswith("NOT RUN")]


def written(project: Path) -> set[str]:
    return set(json.loads((project / "tests" / "soak.json").read_text()))


@pytest.mark.long
def test_a_long_test_is_left_out_once_it_passed_and_runs_again_once_what_it_tests_has_changed(project: Path) -> None:
    assert "4 passed" in run(project)[-1], "never passed: it runs"
    lines = run(project)
    assert not_run(lines) == ["test_it.py::test_long", "test_it.py::test_other"]
    assert any("1 passed, 3 skipped" in line for line in lines)
    (project / "product" / "module.py").write_text("changed")
    lines = run(project)
    assert not_run(lines) == ["test_it.py::test_other"]
    assert any("3 passed, 1 skipped" in line for line in lines)


@pytest.mark.long
def test_what_failed_or_was_run_in_part_is_not_written_down(project: Path) -> None:
    (project / "product" / "module.py").write_text("broken")
    assert "2 failed, 1 passed" in run(project, "-m", "soak")[-1]
    assert written(project) == {"test_it.py::test_other"}
    (project / "product" / "module.py").write_text("sound")
    for part in (["-k", "0 or other"], ["test_it.py::test_long[0]"]):
        assert "passed" in run(project, "-m", "soak", *part)[-1]
        assert written(project) == {"test_it.py::test_other"}, part
    assert "2 passed" in run(project, "-m", "soak", "test_it.py::test_long")[-1]
    assert written(project) == {"test_it.py::test_long", "test_it.py::test_other"}


@pytest.mark.long
def test_what_passed_in_several_processes_is_written_down_and_what_was_broken_off_is_not(project: Path) -> None:
    (project / "product" / "module.py").write_text("broken")
    run(project, "--exitfirst")
    assert not (project / "tests" / "soak.json").exists()
    assert "2 failed, 2 passed" in run(project, "--numprocesses", "2")[-1]
    assert written(project) == {"test_it.py::test_other"}
    (project / "product" / "module.py").write_text("sound")
    run(project, "--numprocesses", "2")
    assert written(project) == {"test_it.py::test_long", "test_it.py::test_other"}


@pytest.mark.long
def test_make_soak_runs_what_has_not_passed_and_what_it_leaves_out_stays_written_down(project: Path) -> None:
    assert "3 passed, 1 deselected" in run(project, "-m", "soak")[-1]
    (project / "other.py").write_text("changed")
    lines = run(project, "-m", "soak")
    assert not_run(lines) == ["test_it.py::test_long"]
    assert any("1 passed, 2 skipped, 1 deselected" in line for line in lines)
    assert written(project) == {"test_it.py::test_long", "test_it.py::test_other"}
    assert not_run(run(project)) == ["test_it.py::test_long", "test_it.py::test_other"]
    assert "3 passed, 1 deselected" in run(project, "-m", "soak", "--soak-all")[-1]


def test_a_renamed_file_and_a_changed_one_change_the_hash_and_a_compiled_one_does_not(project: Path) -> None:
    before = soak.digest_of(project, ("product",))
    (project / "product" / "__pycache__").mkdir()
    (project / "product" / "__pycache__" / "module.pyc").write_bytes(b"1")
    assert soak.digest_of(project, ("product",)) == before
    (project / "product" / "module.py").rename(project / "product" / "renamed.py")
    renamed = soak.digest_of(project, ("product",))
    (project / "product" / "renamed.py").write_text("changed")
    assert len({before, renamed, soak.digest_of(project, ("product",))}) == 3
    with pytest.raises(FileNotFoundError):
        soak.digest_of(project, ("nowhere",))


@pytest.mark.long
def test_what_is_too_long_for_make_test_is_named_there_and_run_by_make_soak(project: Path) -> None:
    file = project / "test_it.py"
    file.write_text(TESTS.replace('soak("other.py")', 'soak("other.py", too_long=True)'))
    lines = run(project)
    assert not_run(lines) == ["test_it.py::test_other"]
    assert any(soak.TOO_LONG in line for line in lines)
    assert written(project) == {"test_it.py::test_long"}
    assert "1 passed" in run(project, "-m", "soak")[-1]
    assert written(project) == {"test_it.py::test_long", "test_it.py::test_other"}
