"""Programs that only the tests need: tshark, which counts the same captures as the packets table, and a Chromium, in
which the report is shown.
"""

from __future__ import annotations

import shutil

from testbed.bootstrap.steps import apt_install, run

CHROMIUM = ("chromium", "chromium-browser", "google-chrome")
"""The names that it has, on one system or another."""


def ensure_chromium() -> None:
    """Make sure that a Chromium is installed."""
    if chromium() is None:
        apt_install(["chromium"], "the tests show the report in Chromium, which is not installed")


def chromium() -> str | None:
    """Where it is; None where it is not."""
    return next((found for name in CHROMIUM if (found := shutil.which(name))), None)


def ensure_checkers() -> None:
    """Make sure that what checks deploy/ is installed: systemd-analyze, and kubectl, which puts manifests together."""
    for program, package in (("systemd-analyze", "systemd"), ("kubectl", "kubernetes-client")):
        if shutil.which(program) is None:
            apt_install([package], f"the tests check deploy/ with {program}, which is not installed")


def ensure_tshark() -> None:
    """Make sure that tshark is installed."""
    if not has_tshark():
        apt_install(["tshark"], "the tests compare the packets table with tshark, which is not installed")


def has_tshark() -> bool:
    return shutil.which("tshark") is not None


def tshark_version() -> str:
    """As `4.4.7`; empty where it says none."""
    lines = run(["tshark", "--version"]).splitlines()  # as root it says something about that first
    found = next((line for line in lines if line.startswith("TShark")), "")
    return found.removeprefix("TShark (Wireshark) ").split(" ")[0].rstrip(".")
