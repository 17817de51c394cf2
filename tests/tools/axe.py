"""axe-core, which looks for what keeps people out of a page: npm's package, pinned by its hash."""

from __future__ import annotations

import hashlib
import shutil
import tarfile
import tempfile
from pathlib import Path

from testbed.bootstrap.steps import CACHE, BootstrapError, apt_install, run, step

VERSION = "4.14.1"
SHA512 = (
    "1477dafa598d8d065f273d6af302aa203c02e83131707b7fa648cd41bd3d6b73"
    "4f8c22a0dab86ee6a6f64b8afbe804b214d36db85a2826965edfb3a0b9d546b5"
)
AXE = CACHE / f"axe-{VERSION}.min.js"


def ensure_axe() -> None:
    """Make sure that axe-core is in the cache."""
    if AXE.exists():
        return
    if shutil.which("npm") is None:
        apt_install(["npm"], "the tests look at the live page with axe-core, a package of npm, which is not installed")
    with step(f"fetching axe-core {VERSION}"), tempfile.TemporaryDirectory() as folder:
        run(["npm", "pack", f"axe-core@{VERSION}", "--silent", "--pack-destination", folder])
        packed = Path(folder) / f"axe-core-{VERSION}.tgz"
        found = hashlib.sha512(packed.read_bytes()).hexdigest()
        if found != SHA512:
            raise BootstrapError(f"axe-core {VERSION}: has hash {found}; expected {SHA512}")
        with tarfile.open(packed) as archive:
            content = archive.extractfile("package/axe.min.js")
            assert content is not None
            AXE.write_bytes(content.read())
