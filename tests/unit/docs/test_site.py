"""The documentation: every page is in the site, every link leads somewhere, and nothing is fetched from elsewhere."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from mqttxt.cli.parameters import parse_command
from spec import options

ROOT = Path(__file__).resolve().parents[3]
ROLE_PAGES = [
    ROOT / "docs" / f"{name}.md"
    for name in ("activator", "conformance", "ground-station", "security", "tutorial", "uav-client")
]


@pytest.mark.long
def test_the_site_builds_strictly_and_needs_nothing_from_elsewhere(tmp_path: Path) -> None:
    built = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)],
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        timeout=110,
        check=False,
    )
    assert (built.returncode, "WARNING" in built.stderr) == (0, False), built.stderr
    pages = [*tmp_path.glob("*.html")]
    assert len(pages) > 5
    for page in pages:
        fetched = re.findall(
            r'<(?:script|img|iframe)[^>]*src="(https?:[^"]*)|<link[^>]*href="(https?:[^"]*)', page.read_text()
        )
        assert fetched == []
    for sheet in tmp_path.rglob("*.css"):
        assert not re.search(r"@import|url\(\s*['\"]?https?:", sheet.read_text())


@pytest.mark.parametrize("page", ROLE_PAGES, ids=lambda page: page.stem)
def test_the_options_of_a_role_are_those_of_its_command(page: Path, tmp_path: Path) -> None:
    copy = tmp_path / page.name
    copy.write_text(page.read_text())
    options.main(str(copy))
    assert copy.read_text() == page.read_text(), "run make docs"


def test_every_subcommand_is_documented() -> None:
    text = "".join(page.read_text() for page in (ROOT / "docs").glob("*.md"))
    told = set(re.findall(r"<!-- generated: options-(\S+) -->", text))
    assert [name for name in options.subcommands() if not told & {name, *options.groups(name)}] == []


def command_lines() -> list[tuple[str, list[str]]]:
    """Every command line of `mqttxt` in the pages, the README included: subcommand and words behind it."""
    found = []
    for page in [*(ROOT / "docs").glob("*.md"), ROOT / "README.md"]:
        text = page.read_text().replace("\\\n", " ")
        for line in re.findall(r"^(?:ExecStart=\S*/|docker exec -it \S+ )?mqttxt (\w.*)$", text, re.MULTILINE):
            words = shlex.split(line, comments=True)
            depth = 2 if words[0] in ("audit", "gs", "conformance", "keys") else 1
            depth += words[:2] in (["gs", "plan"], ["gs", "params"], ["gs", "logs"])
            found.append(("-".join(words[:depth]), words[depth:]))
    return found


def test_every_command_line_in_the_pages_has_options_that_exist() -> None:
    lines, known = command_lines(), options.subcommands()
    assert len(lines) > 15
    for name, words in lines:
        taken = {opt for parameter in known[name].params for opt in parameter.opts}
        assert [word for word in words if word.startswith("--") and word != "--" and word not in taken] == []


def test_every_command_that_the_pages_send_can_be_sent() -> None:
    sent = [words for name, words in command_lines() if name == "gs-send" and "20000" not in words]
    assert len(sent) > 8
    for words in sent:
        valued = {
            index + 1
            for index, word in enumerate(words)
            if word in ("--fog", "--drone", "--cloud", "--ttl", "--identity")
        }
        typed = [word for index, word in enumerate(words) if index not in valued and not word.startswith("--")]
        parse_command(typed[0], typed[1:])


def test_required_options_and_defaults_are_told() -> None:
    shown = options.options(options.subcommands()["uav"])
    assert "| `--drone` | This drone's number: its autopilot's MAVLink system id. | required |" in shown
    assert "| `udp:127.0.0.1:14540` |" in shown


def test_what_every_station_takes_is_told_once() -> None:
    told = [page.name for page in (ROOT / "docs").glob("*.md") if "`MQTTXT_SIGNED_STATES`" in page.read_text()]
    assert told == ["ground-station.md"]
    sent = options.options(options.subcommands()["gs-send"])
    assert "`MQTTXT_CLOUD`" not in sent
    assert sent.endswith("And [the options of every station](ground-station.md#options-of-every-station).")
    assert "And [" not in options.options(options.subcommands()["gs-share-list"])


@pytest.mark.parametrize(
    "page", [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))], ids=lambda page: page.name
)
def test_what_is_installed_is_in_the_clone_because_no_registry_has_it(page: Path) -> None:
    installed = re.findall(r"^pip install (.*)$", page.read_text(), re.MULTILINE)
    for what in (shlex.split(line, comments=True) for line in installed):
        assert [one for one in what if not (ROOT / one.partition("[")[0] / "pyproject.toml").exists()] == []
