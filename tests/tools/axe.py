"""axe-core, which looks for what keeps people out of a page."""

from __future__ import annotations

from testbed.bootstrap.steps import CACHE, step

from .npm import NpmPackage

PACKAGE = NpmPackage(
    "axe-core",
    "4.14.1",
    "1477dafa598d8d065f273d6af302aa203c02e83131707b7fa648cd41bd3d6b73"
    "4f8c22a0dab86ee6a6f64b8afbe804b214d36db85a2826965edfb3a0b9d546b5",
)
AXE = CACHE / f"axe-{PACKAGE.version}.min.js"


def ensure_axe() -> None:
    """Make sure that axe-core is in the cache."""
    if AXE.exists():
        return
    with step(f"fetching axe-core {PACKAGE.version}"):
        (content,) = PACKAGE.files(["axe.min.js"])
        AXE.write_bytes(content)
