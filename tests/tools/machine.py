"""A virtual machine for tests whose kernel has netem: Debian's, and an initramfs with Python, ip, tc and iptables.

Always amd64, emulated by QEMU in software, so it is the same on every host and needs no rights. Only files of Debian's
packages are used: none of them is installed, so nothing of a package runs while the initramfs is made.
"""

from __future__ import annotations

import hashlib
import lzma
import os
import re
import shutil
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path

from testbed.bootstrap.steps import CACHE, BootstrapError, apt_install, check_disk, run, step

from .cpio import Archive

QEMU = "qemu-system-x86_64"
RELEASE = "trixie"
PACKAGES = ("linux-image-cloud-amd64", "iproute2", "ethtool", "iptables", "python3-minimal", "libpython3-stdlib")
MODULES = (
    *("veth", "ifb", "sch_netem", "sch_htb", "sch_ingress", "cls_u32", "cls_fw", "act_mirred", "act_skbedit"),
    *("iptable_filter", "xt_NFQUEUE", "nfnetlink_queue"),
)
FOLDER = CACHE / "machine"
KERNEL = FOLDER / "vmlinuz"
INITRAMFS = FOLDER / "initramfs.cpio"
"""Without compression, which would take the emulated machine longer than reading it; a test appends its own."""
NEED_MIB = 800
_MARK = FOLDER / ".made-from"
_LIBRARIES = "usr/lib/x86_64-linux-gnu"
_PROGRAMS = (
    *("usr/bin/python3", "usr/sbin/ip", "usr/sbin/tc", "usr/sbin/ethtool"),
    *("usr/sbin/iptables-legacy", "usr/sbin/iptables-legacy-restore"),
)
_FOLDERS = ("dev", "etc", "proc", "root", "run", "sys", "tmp", "var", "usr", "usr/bin", "usr/sbin", "usr/lib")
_LINKS = {"bin": "usr/bin", "sbin": "usr/sbin", "lib": "usr/lib", "lib64": "usr/lib64"}
_LEFT_OUT = ("/gconv/", "/perl", "/krb5/", "/engines-3/", "/idlelib/", "/test/", "/ensurepip/", "/pydoc_data/")


def ensure_machine() -> None:
    """QEMU is installed, kernel and initramfs are in the cache; made again when what they are made from changes."""
    if not has_qemu():
        apt_install(["qemu-system-x86"], "the tests compare the links with a kernel in QEMU, which is not installed")
    if machine_is_current():
        return
    check_disk(CACHE.parent, NEED_MIB)
    if shutil.which("mmdebstrap") is None:
        packages = ["mmdebstrap", "debian-archive-keyring"]
        apt_install(
            packages, "the kernel that the tests compare the links with is fetched by mmdebstrap, not installed"
        )
    with step(f"making a virtual machine from Debian's packages ({RELEASE})"):
        shutil.rmtree(FOLDER, ignore_errors=True)
        FOLDER.mkdir(parents=True)
        with tempfile.TemporaryDirectory(dir=FOLDER) as scratch:
            _make(Path(scratch))
        _MARK.write_text(_key())


def has_qemu() -> bool:
    return shutil.which(QEMU) is not None


def machine_is_current() -> bool:
    """Whether kernel and initramfs are there and made by this program."""
    return _MARK.exists() and _MARK.read_text() == _key()


def _key() -> str:
    sources = (Path(__file__), Path(__file__).with_name("cpio.py"))
    return hashlib.sha256(b"\0".join(source.read_bytes() for source in sources)).hexdigest()


def _make(scratch: Path) -> None:
    packed, tree = scratch / "tree.tar", scratch / "tree"
    mode = ("--mode=chrootless",) if os.geteuid() else ()  # for others than root, and refused to root
    run(
        [
            *("mmdebstrap", "--quiet", *mode, "--variant=extract", "--architectures=amd64"),
            *(f"--include={','.join(PACKAGES)}", RELEASE, str(packed)),
        ]
    )
    tree.mkdir()
    run(["tar", "-xf", str(packed), "-C", str(tree), "--exclude=./dev/*", "--exclude=./usr/share/*"])
    kernels = list(tree.glob("boot/vmlinuz-*"))
    if len(kernels) != 1:
        raise BootstrapError(f"{PACKAGES[0]} of {RELEASE} has {len(kernels)} kernels; expected one")
    shutil.copyfile(kernels[0], KERNEL)
    with INITRAMFS.open("wb") as out:
        archive_of(tree, Archive(out))


def archive_of(tree: Path, archive: Archive) -> None:
    """Folders, programs with all libraries, Python, tc's tables; the modules, numbered in the order of loading."""
    for name in (*_FOLDERS, "usr/lib64", "modules"):
        archive.folder(name)
    for name, target in _LINKS.items():
        archive.link(name, target)
    archive.link("usr/lib64/ld-linux-x86-64.so.2", f"/{_LIBRARIES}/ld-linux-x86-64.so.2")
    seen = set(_FOLDERS)
    for path in _chosen(tree):
        name = str(path.relative_to(tree))
        for parent in reversed(Path(name).parents):
            if str(parent) not in {".", *seen}:
                seen.add(str(parent))
                archive.folder(str(parent))
        if path.is_symlink():
            archive.link(name, str(path.readlink()))
        else:
            archive.file(name, path.read_bytes(), bool(path.stat().st_mode & stat.S_IXUSR))
    for number, (name, content) in enumerate(modules_in_order(tree)):
        archive.file(f"modules/{number:02}-{name}.ko", content, False)
    archive.console()
    archive.end()


def modules_in_order(tree: Path) -> Iterator[tuple[str, bytes]]:
    """The wanted modules, each after those that it needs; raises BootstrapError where the kernel lacks one."""
    files = {path.name.partition(".")[0].replace("-", "_"): path for path in tree.glob("usr/lib/modules/*/**/*.ko*")}
    loaded: set[str] = set()

    def load(name: str) -> Iterator[tuple[str, bytes]]:
        if name in loaded:
            return
        loaded.add(name)
        if name not in files:
            raise BootstrapError(f"{PACKAGES[0]} of {RELEASE} has no module {name}; expected it for the tests' links")
        path = files[name]
        content = lzma.decompress(path.read_bytes()) if path.suffix == ".xz" else path.read_bytes()
        told = re.search(rb"\0depends=([^\0]*)\0", content)
        for needed in filter(None, told[1].decode().split(",") if told else ()):
            yield from load(needed.replace("-", "_"))
        yield name, content

    for wanted in MODULES:
        yield from load(wanted)


def _chosen(tree: Path) -> Iterator[Path]:
    for name in _PROGRAMS:
        path = tree / name
        while path.is_symlink():
            yield path
            path = path.parent / path.readlink()
        yield path
    for folder in (tree / _LIBRARIES, *tree.glob("usr/lib/python3.*")):
        for path in sorted(folder.rglob("*")):
            if not path.is_dir() and not any(part in f"/{path.relative_to(tree)}" for part in _LEFT_OUT):
                yield path
