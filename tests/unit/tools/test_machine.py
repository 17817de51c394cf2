"""The tests' virtual machine: what goes into it and in which order."""

from __future__ import annotations

import io
import lzma
import shutil
import subprocess
from pathlib import Path

import pytest

from testbed.bootstrap.steps import BootstrapError
from tests.tools import machine
from tests.tools.cpio import Archive


def module(tree: Path, name: str, needs: str = "") -> bytes:
    """A kernel module's file, as far as loading order needs it."""
    content = b"\x7fELF\0license=GPL\0depends=" + needs.encode() + b"\0name=" + name.encode() + b"\0"
    path = tree / "usr/lib/modules/6.12/kernel" / f"{name}.ko.xz"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(lzma.compress(content))
    return content


def test_a_module_comes_after_those_it_needs_and_only_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "MODULES", ("xt_NFQUEUE", "nfnetlink_queue"))
    wanted = module(tmp_path, "xt_NFQUEUE", "x_tables,nfnetlink-queue")
    for name, needs in (("x_tables", ""), ("nfnetlink-queue", "nfnetlink"), ("nfnetlink", ""), ("veth", "")):
        module(tmp_path, name, needs)
    found = list(machine.modules_in_order(tmp_path))
    assert [name for name, _ in found] == ["x_tables", "nfnetlink", "nfnetlink_queue", "xt_NFQUEUE"]
    assert found[-1][1] == wanted


def test_a_kernel_without_netem_is_no_kernel_for_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "MODULES", ("sch_netem",))
    with pytest.raises(BootstrapError, match="has no module sch_netem"):
        list(machine.modules_in_order(tmp_path))


@pytest.mark.skipif(shutil.which("cpio") is None, reason="cpio is not installed")
def test_cpio_reads_what_is_written(tmp_path: Path) -> None:
    out = io.BytesIO()
    archive = Archive(out)
    archive.folder("usr")
    archive.link("bin", "usr")
    archive.file("usr/program", b"odd", True)
    archive.file("usr/text", b"", False)
    archive.end()
    subprocess.run(["cpio", "-idm", "--quiet"], input=out.getvalue(), cwd=tmp_path, check=True)
    assert (tmp_path / "bin/program").read_bytes() == b"odd"
    assert (tmp_path / "usr/program").stat().st_mode & 0o777 == 0o755
    assert (tmp_path / "usr/text").stat().st_size == 0


def test_without_qemu_it_is_installed_or_the_command_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[list[str]] = []
    monkeypatch.setattr(machine, "machine_is_current", lambda: True)
    monkeypatch.setattr(machine, "has_qemu", lambda: False)
    monkeypatch.setattr(machine, "apt_install", lambda packages, why: asked.append(packages))
    machine.ensure_machine()
    assert asked == [["qemu-system-x86"]]
