"""The images: a Debian base, made here if no registry answers, and the node image on top of it."""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from pathlib import Path

from .steps import CACHE, ROOT, BootstrapError, apt_install, check_disk, run, step, succeeds

BASE = "debian:trixie-slim"
NODE = "mqttxt-testbed/node:latest"
LABEL = "org.mqttxt.inputs"
PULL_TIMEOUT_S = 60
IMAGES_NEED_MIB = 2500
_CA_BUNDLES = ("/etc/ssl/certs/ca-certificates.crt", "/etc/pki/tls/certs/ca-bundle.crt", "/etc/ssl/cert.pem")


def ensure_images() -> None:
    """Make missing images, and the node image again if its sources have changed."""
    wanted = node_inputs()
    if _label() == wanted:
        return
    check_disk(storage(), IMAGES_NEED_MIB)
    if not has_image(BASE):
        _make_base()
    with step("building the node image"):
        _prepare_ca_bundle()
        run(
            [
                *("docker", "build", "--network", "host", "--label", f"{LABEL}={wanted}"),
                *("--tag", NODE, "--file", "services/Dockerfile", "."),
            ]
        )


def node_is_current() -> bool:
    """Whether the node image exists and is made from the current sources."""
    return _label() == node_inputs()


def storage() -> Path:
    """The folder in which the daemon keeps its images; this repository's folder if that is not visible from here."""
    kept = Path(run(["docker", "info", "--format", "{{.DockerRootDir}}"]).strip())
    return kept if kept.is_dir() else ROOT


def has_image(name: str) -> bool:
    return succeeds(["docker", "image", "inspect", name])


def node_inputs(root: Path = ROOT) -> str:
    """A digest of everything that the node image is made from."""
    digest = hashlib.sha256()
    for path in [root / "requirements" / "node.txt", *sorted((root / "services").rglob("*"))]:
        name = path.relative_to(root)
        if path.is_file() and not any(_is_left_over(part) for part in name.parts):
            digest.update(f"{name}\0{path.stat().st_mode & 0o100}\0".encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()


def _is_left_over(part: str) -> bool:
    """Whether a file or folder was made by a tool; .dockerignore excludes the same ones."""
    return part.startswith(".") or part == "__pycache__" or part.endswith(".egg-info")


def _label() -> str | None:
    try:
        found = run(["docker", "image", "inspect", "--format", f'{{{{index .Config.Labels "{LABEL}"}}}}', NODE])
    except BootstrapError:
        return None
    return found.strip()


def _make_base() -> None:
    """Pull the base image if a registry answers, else make it from Debian's packages."""
    with step(f"looking for {BASE} at a registry"):
        pulled = succeeds(["docker", "pull", "--quiet", BASE], timeout_s=PULL_TIMEOUT_S)
    if pulled:
        return
    if shutil.which("mmdebstrap") is None:
        packages = ["mmdebstrap", "debian-archive-keyring"]
        apt_install(packages, f"no registry has {BASE}, and mmdebstrap is not installed to make it")
    if os.geteuid() != 0:
        needs = f"no registry has {BASE}, and making it with mmdebstrap needs root"
        raise BootstrapError(f"{needs}; type: sudo python3 -m testbed.bootstrap containers")
    with step(f"making {BASE} from Debian's packages"), tempfile.TemporaryDirectory() as folder:
        archive = Path(folder) / "base.tar"
        slim = ["--dpkgopt=path-exclude=/usr/share/doc/*", "--dpkgopt=path-exclude=/usr/share/man/*"]
        run(["mmdebstrap", "--quiet", "--variant=minbase", *slim, "trixie", str(archive)])
        run(["docker", "import", str(archive), BASE])


def _prepare_ca_bundle() -> None:
    """Hand the host's CA bundle to the build stage, so that a TLS-inspecting proxy does not break pip."""
    target = CACHE / "build" / "ca-certificates.crt"
    target.parent.mkdir(parents=True, exist_ok=True)
    named = os.environ.get("PIP_CERT") or os.environ.get("SSL_CERT_FILE")
    for candidate in ((named,) if named else ()) + _CA_BUNDLES:
        if Path(candidate).is_file():
            target.write_bytes(Path(candidate).read_bytes())
            return
    target.write_bytes(b"")
