"""Packages of npm, pinned by their hashes."""

from __future__ import annotations

import hashlib
import shutil
import tarfile
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from testbed.bootstrap.steps import BootstrapError, apt_install, run


@dataclass(frozen=True)
class NpmPackage:
    """One version of a package; `sha512` is that of what npm packs."""

    name: str
    version: str
    sha512: str

    def files(self, paths: Sequence[str]) -> list[bytes]:
        """Files of the package; raises BootstrapError where npm is missing, or packs something else."""
        if shutil.which("npm") is None:
            apt_install(["npm"], f"{self.name} is a package of npm, which is not installed")
        with tempfile.TemporaryDirectory() as folder:
            run(["npm", "pack", f"{self.name}@{self.version}", "--silent", "--pack-destination", folder])
            (packed,) = Path(folder).iterdir()
            found = hashlib.sha512(packed.read_bytes()).hexdigest()
            if found != self.sha512:
                raise BootstrapError(f"{self.name} {self.version}: has hash {found}; expected {self.sha512}")
            with tarfile.open(packed) as archive:
                contents = [archive.extractfile(f"package/{path}") for path in paths]
                return [content.read() for content in contents if content is not None]
