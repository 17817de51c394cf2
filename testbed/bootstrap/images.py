"""The images: a Debian base that is made where no registry answers, and the node image on top of it."""

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
_CA_BUNDLES = ("/etc/ssl/certs/ca-certificates.crt", "/etc/pki/tls/certs/ca-bundle.crt", "/etc/ssl/cert.pem")


def ensure_images() -> None:
    """Make what is missing; the node image is made again when what goes into it has changed."""
    wanted = node_inputs()
    if _label() == wanted:
        return
    check_disk(ROOT, 3000)
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


def has_image(name: str) -> bool:
    return succeeds(["docker", "image", "inspect", name])


def node_inputs() -> str:
    """A digest of everything that the node image is made from."""
    digest = hashlib.sha256()
    files = [ROOT / "requirements" / "node.txt", *sorted((ROOT / "services").rglob("*"))]
    for path in files:
        if path.is_file() and "__pycache__" not in path.parts and path.suffix != ".md":
            digest.update(f"{path.relative_to(ROOT)}\0{path.stat().st_mode & 0o111}\0".encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()


def _label() -> str | None:
    try:
        found = run(["docker", "image", "inspect", "--format", f'{{{{index .Config.Labels "{LABEL}"}}}}', NODE])
    except BootstrapError:
        return None
    return found.strip()


def _make_base() -> None:
    """Pull the base image where a registry answers, else make it from Debian's packages."""
    with step(f"looking for {BASE} at a registry"):
        pulled = succeeds(["docker", "pull", "--quiet", BASE], timeout_s=PULL_TIMEOUT_S)
    if pulled:
        return
    if shutil.which("mmdebstrap") is None:
        apt_install(["mmdebstrap"], f"no registry has {BASE}, and mmdebstrap is not installed to make it")
    if os.geteuid() != 0:
        raise BootstrapError(f"no registry has {BASE}; making it with mmdebstrap needs root: type sudo make doctor")
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
