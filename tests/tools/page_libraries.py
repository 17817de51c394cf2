"""The live page's libraries for vector tiles: `python -m tests.tools.page_libraries FOLDER` writes them there.

FOLDER is services/mqttxt/src/mqttxt/page/assets. They are files of npm's packages as they are, but that one imports
another by its file's name: a browser knows no packages.
"""

from __future__ import annotations

import sys
from pathlib import Path

from .npm import NpmPackage

POINT = "point-geometry.js"
LIBRARIES = {
    "pbf.js": (
        NpmPackage(
            "pbf",
            "5.1.2",
            "9a7bc676f3ab22f24e04650474692b5578cdf04fd590824291fd9e4b50c7db2b"
            "fcd8e45494bb6d983b74ad6637f32619995c1c899c0152f1ccdb4ab10597f8d3",
        ),
        "LICENSE",
    ),
    "vector-tile.js": (
        NpmPackage(
            "@mapbox/vector-tile",
            "3.0.0",
            "41fd744b5b881cc936d2b8bf215067a52f9eb1412455a4791dfb66cfcf234c89"
            "eba665a03c625f3dedcb5638e513beedacbc7cb47eaa8d31bbb961fd848abfd1",
        ),
        "LICENSE.txt",
    ),
    POINT: (
        NpmPackage(
            "@mapbox/point-geometry",
            "1.1.0",
            "606701cf5720e004d70c233fef52fdc6f7a1e1dca77c699c2c3aae7d1fa7410c"
            "b77cac2c019b1677fc78eb6d7feae25a781f66c0e1c4ea13de0e05f3f6e56251",
        ),
        "LICENSE",
    ),
}


def write(folder: Path) -> None:
    """Write the libraries and their licences; raises BootstrapError."""
    licences = []
    for name, (package, licence) in LIBRARIES.items():
        source, terms = (content.decode() for content in package.files(["index.js", licence]))
        (folder / name).write_text(source.replace("'@mapbox/point-geometry'", f"'./{POINT}'"), encoding="utf-8")
        licences.append(f"{name} is index.js of {package.name} {package.version}.\n\n{terms.strip()}\n")
    (folder / "licences.txt").write_text("\n".join(licences), encoding="utf-8")


if __name__ == "__main__":
    write(Path(sys.argv[1]))
