"""The first screen of a report, as Chromium shows it: `python -m tests.tools.screenshot REPORT PICTURE`.

docs/pictures/report.png is made so; make it again when the report's head changes.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from .programs import chromium

WIDTH, HEIGHT = 1060, 1240
TIMEOUT_S = 60.0


def shoot(report: Path, picture: Path) -> None:
    """Write the picture, a PNG of WIDTH and HEIGHT pixels. Raises OSError where there is no report, or no Chromium."""
    program = chromium()
    if program is None:
        raise FileNotFoundError("no Chromium; type: make tools")
    page = report.resolve(strict=True).as_uri()
    with tempfile.TemporaryDirectory() as profile:
        options = ("--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", f"--user-data-dir={profile}")
        size = f"--window-size={WIDTH},{HEIGHT}"
        subprocess.run(
            [program, *options, size, f"--screenshot={picture.resolve()}", page],
            check=True,
            capture_output=True,
            timeout=TIMEOUT_S,
        )


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: python -m tests.tools.screenshot REPORT PICTURE")
    try:
        shoot(*map(Path, sys.argv[1:]))
    except OSError as error:
        sys.exit(f"screenshot: {error}")
