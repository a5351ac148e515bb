"""Builder of the images of environments from this checkout: `python -P -m provisioning.image`.

`rce/system` is Debian, from a registry or, if there is none, by debootstrap. The Dockerfiles in `containers/images`
build `rce/base`, `rce/mapping`, `rce/mapping3d`, `rce/agent` and, if asked for, `rce/server` on it. In most of them our
code comes last, because it changes most often.
"""

from __future__ import annotations

import argparse
import io
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
import threading
import tomllib
from collections.abc import Iterator
from pathlib import Path

import docker
from docker.errors import APIError, DockerException, ImageNotFound

from provisioning.steps import CONSTRAINTS, ROOT
from rce import __version__
from rce.errors import RceError, StartFailed, Unavailable

IMAGES = ROOT / "containers" / "images"
SYSTEM, GROUND, BASE, AGENT = "rce/system", "rce/ground", "rce/base", "rce/agent"
MAPPING, MAPPING3D = "rce/mapping", "rce/mapping3d"
SERVER = "rce/server"  # of Master, Robot endpoint and task set on Kubernetes
RELEASE = "bookworm"
REGISTRY_IMAGE = f"debian:{RELEASE}-slim"
REGISTRY_TIMEOUT = 10.0  # seconds until a registry begins to answer
IN_SYSTEM = ("python3", "python3-venv", "tini")
REMOVED_CONTENT = (  # directories of Debian that are emptied
    "usr/share/doc",
    "usr/share/man",
    "usr/share/locale",
    "usr/share/info",
    "var/cache/apt",
    "var/lib/apt/lists",
)
CODE = ("rce", "endpoints", "converters", "containers/__init__.py", "containers/nodes")
AGENT_CODE = ("rce", "containers")
SERVER_CODE = ("rce", "master", "endpoints", "containers", "converters")
EXTRAS = {
    "base.txt": ("environment", "ros"),
    "mapping.txt": ("mapping",),
    "mapping3d.txt": ("mapping3d",),
    "agent.txt": ("environment", "docker"),
    "server.txt": ("server", "postgresql", "kubernetes"),
}
PIP_SETTINGS = ("PIP_INDEX_URL", "PIP_EXTRA_INDEX_URL", "PIP_TRUSTED_HOST", "PIP_DEFAULT_TIMEOUT")
PROXIES = ("HTTP_PROXY", "HTTPS_PROXY", "NO_PROXY", "http_proxy", "https_proxy", "no_proxy")
CERTIFICATES = ("PIP_CERT", "SSL_CERT_FILE", "REQUESTS_CA_BUNDLE", "CURL_CA_BUNDLE")
BUNDLE = "/etc/ssl/certs/ca-certificates.crt"


class Builder:
    """Builder of images by one Docker daemon."""

    def __init__(self, api: docker.APIClient) -> None:
        self._api = api

    def build(self) -> None:
        """Build all images.

        Raises:
            StartFailed: A build failed. The message has its last lines.
            Unavailable: There is no base image, and none can be made.
        """
        if not self._has(SYSTEM):
            self._make_system()
        context = make_context()
        base, version = "images/base/Dockerfile", f":{__version__}"
        self.make(context, base, f"{GROUND}{version}", {"SYSTEM": SYSTEM}, target="ground")
        self.make(context, base, f"{BASE}{version}", {"SYSTEM": SYSTEM})
        self.make(context, "images/mapping/Dockerfile", f"{MAPPING}{version}", {"GROUND": f"{GROUND}{version}"})
        self.make(context, "images/mapping3d/Dockerfile", f"{MAPPING3D}{version}", {"MAPPING": f"{MAPPING}{version}"})
        self.make(context, "images/agent/Dockerfile", f"{AGENT}{version}", {"GROUND": f"{GROUND}{version}"})

    def build_server(self) -> None:
        """Build the image of the programs on Kubernetes, after the others.

        Raises:
            StartFailed: The build failed. The message has its last lines.
        """
        version = f":{__version__}"
        self.make(make_context(), "images/server/Dockerfile", f"{SERVER}{version}", {"GROUND": f"{GROUND}{version}"})

    def sizes(self) -> dict[str, int]:
        """Return the sizes of the built images in bytes."""
        names = (BASE, MAPPING, MAPPING3D, AGENT, SERVER)
        tags = [tag for name in names if self._has(tag := f"{name}:{__version__}")]
        return {tag: self._api.inspect_image(tag)["Size"] for tag in tags}

    def _has(self, tag: str) -> bool:
        try:
            self._api.inspect_image(tag)
        except ImageNotFound:
            return False
        return True

    def _make_system(self) -> None:
        if self._pull():
            self._api.tag(REGISTRY_IMAGE, SYSTEM)
            return
        _report(f"no registry answers: making {SYSTEM} by debootstrap, which takes some minutes")
        with tempfile.TemporaryDirectory(prefix="rce-image-") as directory:
            self._api.import_image_from_data(_debootstrap(Path(directory)), repository=SYSTEM, tag="latest")

    def _pull(self) -> bool:
        """Pull the base image, and return False if no registry has it or begins to answer in time."""
        outcome: list[bool] = []
        began = threading.Event()

        def pull() -> None:
            try:
                for _ in self._api.pull(REGISTRY_IMAGE, stream=True, decode=True):
                    began.set()
                outcome.append(self._has(REGISTRY_IMAGE))
            except DockerException:
                outcome.append(False)
            began.set()

        thread = threading.Thread(target=pull, daemon=True)
        thread.start()
        if not began.wait(REGISTRY_TIMEOUT):
            return False
        thread.join()
        return outcome[0]

    def make(self, context: bytes, dockerfile: str, tag: str, arguments: dict[str, str], target: str = "") -> None:
        """Build one image.

        Raises:
            StartFailed: The build failed. The message has its last lines.
        """
        _report(f"building {tag}")
        settings = {key: os.environ[key] for key in (*PIP_SETTINGS, *PROXIES) if key in os.environ}
        if host_bundle():
            settings["PIP_CERT"] = BUNDLE
        output = self._api.build(
            fileobj=io.BytesIO(context),
            custom_context=True,
            dockerfile=dockerfile,
            tag=tag,
            target=target or None,
            buildargs={**settings, **arguments},
            labels={"rce.version": __version__},
            network_mode="host",  # pip and apt reach what this machine reaches
            rm=True,
            decode=True,
        )
        _follow(tag, output)


def _report(text: str) -> None:
    """Report progress on standard error; standard output is for the result."""
    print(text, file=sys.stderr, flush=True)


def _follow(tag: str, output: Iterator[dict[str, str]]) -> None:
    lines: list[str] = []
    for item in output:
        lines.append(item.get("stream", ""))
        if "error" in item:
            raise StartFailed(f"{''.join(lines[-30:])}\n{tag} was not built: {item['error']}")


def host_bundle() -> Path | None:
    """Return the file of CA certificates that this machine is set to use, which builds behind a TLS proxy need too."""
    return next((Path(os.environ[key]) for key in CERTIFICATES if Path(os.environ.get(key, "")).is_file()), None)


def requirements(extras: tuple[str, ...]) -> str:
    """Return the dependencies of these extras as a requirements file of pip, with the versions of constraints.txt."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    optional = project["optional-dependencies"]
    items = ["-c constraints.txt", *project["dependencies"], *(item for extra in extras for item in optional[extra])]
    return "".join(f"{item}\n" for item in dict.fromkeys(items))


def make_context() -> bytes:
    """Return the files that the Dockerfiles copy, as a tar archive.

    Times of files are 0, because Numba and Python compare them to recognize an unchanged file in another layer.
    """
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w", format=tarfile.PAX_FORMAT) as archive:
        for path in sorted(IMAGES.rglob("*")):
            add_file(archive, path, f"images/{path.relative_to(IMAGES)}")
        for name, extras in EXTRAS.items():
            add_text(archive, requirements(extras).encode(), name)
        add_file(archive, CONSTRAINTS, CONSTRAINTS.name)
        add_text(archive, b"", "certificates/.none")
        bundle = host_bundle()
        if bundle is not None:
            add_text(archive, bundle.read_bytes(), "certificates/ca-certificates.crt")
        for name in CODE:
            add_file(archive, ROOT / name, f"code/{name}")
        for name in AGENT_CODE:
            add_file(archive, ROOT / name, f"agent/{name}")
        for name in SERVER_CODE:
            add_file(archive, ROOT / name, f"server/{name}")
    return buffer.getvalue()


def add_file(archive: tarfile.TarFile, path: Path, name: str) -> None:
    """Add a file or directory, with owner and time removed."""
    archive.add(path, name, filter=_plain)


def add_text(archive: tarfile.TarFile, content: bytes, name: str) -> None:
    """Add a file with this content."""
    info = tarfile.TarInfo(name)
    info.size = len(content)
    archive.addfile(info, io.BytesIO(content))


def _plain(info: tarfile.TarInfo) -> tarfile.TarInfo | None:
    if "__pycache__" in info.name:
        return None
    info.uid = info.gid = info.mtime = 0
    info.uname = info.gname = ""
    return info


def _debootstrap(directory: Path) -> bytes:
    """Make a minimal Debian and return it as a tar archive.

    Raises:
        Unavailable: There is no debootstrap, or the process does not run as root.
        StartFailed: debootstrap failed.
    """
    if shutil.which("debootstrap") is None or os.geteuid() != 0:
        raise Unavailable(
            f"no registry has {REGISTRY_IMAGE}; to make it here, install debootstrap (apt-get install debootstrap) "
            "and run this as root"
        )
    target = directory / "root"
    command = ["debootstrap", "--variant=minbase", f"--include={','.join(IN_SYSTEM)}", RELEASE, str(target)]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    if done.returncode:
        raise StartFailed(f"{done.stdout[-2000:]}\ndebootstrap exited with status {done.returncode}")
    for name in REMOVED_CONTENT:
        shutil.rmtree(target / name)
        (target / name).mkdir()
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w") as archive:
        archive.add(target, ".")
    return buffer.getvalue()


def main() -> int:
    """Run the program and return its exit status."""
    parser = argparse.ArgumentParser(prog="provision image")
    parser.add_argument("--server", action="store_true", help="also build that of the programs on Kubernetes")
    options = parser.parse_args()
    try:
        builder = Builder(docker.APIClient(**docker.utils.kwargs_from_env(), version="auto", timeout=600))
        builder.build()
        if options.server:
            builder.build_server()
    except (RceError, APIError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except DockerException as error:
        print(f"error: Docker does not answer: {error}", file=sys.stderr)
        return 1
    print(", ".join(f"{tag} ({size / 1e6:.0f} MB)" for tag, size in builder.sizes().items()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
