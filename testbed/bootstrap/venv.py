"""The virtual environment: made from the pinned requirements, and made again when they change."""

from __future__ import annotations

import hashlib
import importlib.util
import shutil
import sys

from .steps import CACHE, ROOT, apt_install, check_disk, check_python, run, step

VENV = ROOT / ".venv"
LOCK = ROOT / "requirements" / "testbed.txt"
SOURCES = (
    ".",
    "services/mqttxt/src",
    "services/sitl/src",
    "services/mission/src",
    "services/net/src",
    "services/sensor/src",
    "services/router/src",
)
COMMANDS = {"mqttxt": "mqttxt.cli", "testbed": "testbed.cli.commands"}
"""The commands in `.venv/bin`, with the modules whose `main` they run."""
_MARK = VENV / ".made-from"
_OLD = ROOT / ".cache" / "venv-before"


def ensure_venv() -> None:
    """Make `.venv` unless it is made from the current lock file; if that fails, the previous one is kept."""
    check_python()
    CACHE.mkdir(exist_ok=True)
    if not venv_is_current():
        _make_anew()
    _write_commands()


def _make_anew() -> None:
    check_disk(ROOT, 1500)
    shutil.rmtree(_OLD, ignore_errors=True)
    if VENV.exists():
        VENV.rename(_OLD)
    try:
        _make()
    except BaseException:
        shutil.rmtree(VENV, ignore_errors=True)
        if _OLD.exists():
            _OLD.rename(VENV)
        raise
    shutil.rmtree(_OLD, ignore_errors=True)


def _make() -> None:
    if not (_has_module("venv") and _has_module("ensurepip")):
        version = f"{sys.version_info.major}.{sys.version_info.minor}"
        apt_install([f"python{version}-venv"], f"{sys.executable} has no venv module")
    with step("making the virtual environment"):
        run([sys.executable, "-m", "venv", str(VENV)])
    with step("installing the pinned requirements"):
        pip = [str(VENV / "bin" / "pip"), "install", "--quiet", "--disable-pip-version-check"]
        run([*pip, "--require-hashes", "--only-binary", ":all:", "--requirement", str(LOCK)])
    site = next((VENV / "lib").glob("python3.*")) / "site-packages"
    (site / "mqttxt-testbed.pth").write_text("".join(f"{ROOT / source}\n" for source in SOURCES))
    _MARK.write_text(_key())


def _write_commands() -> None:
    for name, module in COMMANDS.items():
        path = VENV / "bin" / name
        code = f"import sys; sys.argv[0] = '{name}'; from {module} import main; main()"
        text = f'#!/bin/sh\nexec \'{VENV}/bin/python\' -c "{code}" "$@"\n'
        if not path.exists() or path.read_text() != text:
            path.write_text(text)
            path.chmod(0o755)


def _has_module(name: str) -> bool:
    return importlib.util.find_spec(name) is not None


def venv_is_current() -> bool:
    """Whether `.venv` was made from the current lock file by this Python, in this folder."""
    return _MARK.exists() and _MARK.read_text() == _key()


def lock() -> None:
    """Pin `requirements/*.in`, with hashes, for every platform and Python from 3.11 on; keeps pins that still fit."""
    _pin()


def upgrade() -> None:
    """As `lock`, but pin the newest version of every package."""
    _pin("--upgrade")


def _pin(*how: str) -> None:
    tools = CACHE / "lock-tools"
    with step("pinning the requirements"):
        run([sys.executable, "-m", "venv", str(tools)])
        run([str(tools / "bin" / "pip"), "install", "--quiet", "uv"])
        for name, more in (("testbed", []), ("node", []), ("mavproxy", ["--no-deps"])):
            options = [*more, *how, "--universal", "--python-version", "3.11", "--generate-hashes"]
            hidden = ["--no-emit-index-url", "--no-emit-find-links", "--custom-compile-command", "make lock"]
            files = [f"requirements/{name}.in", "--output-file", f"requirements/{name}.txt"]
            run([str(tools / "bin" / "uv"), "pip", "compile", "--quiet", *options, *hidden, *files])


def _key() -> str:
    parts = (LOCK.read_bytes(), sys.version.encode(), str(ROOT).encode(), "\n".join(SOURCES).encode())
    return hashlib.sha256(b"\0".join(parts)).hexdigest()
