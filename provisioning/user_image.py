"""`rce image build DIR`: an image of environments with a user's ROS packages, based on an image of the platform.

It is for packages that pip must install (ament_python), with their dependencies. Type support is built here, by
provisioning.typesupport. Packages in C and C++ are refused, because the images have no compiler.
"""

from __future__ import annotations

import argparse
import io
import re
import subprocess
import sys
import sysconfig
import tarfile
import tempfile
from pathlib import Path

import docker
from docker.errors import APIError, DockerException

from provisioning import typesupport
from provisioning.image import IMAGES, MAPPING, Builder, add_file, add_text, host_bundle
from rce import __version__
from rce.errors import InvalidRequest, NotFound, RceError, StartFailed
from rce.packages import layout
from rce.packages.archive import Entry
from rce.process import programs

USER_IMAGE = IMAGES / "user"
BUILT_BY_PIP = ("setup.py", "setup.cfg", "pyproject.toml")
PROGRAMS = ("scripts", "nodes")  # directories whose files become executables of the package
_REPOSITORY = re.compile(r"[a-z0-9]+(?:[._/-][a-z0-9]+)*")


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    whole = argparse.ArgumentParser(prog="rce image", description="Images for environments, on this machine's Docker.")
    commands = whole.add_subparsers(dest="command", required=True)
    build = commands.add_parser(
        "build",
        help="make an image with your own ROS packages",
        description="DIR is a ROS package, or has several: what pip installs (ament_python), with what it depends on, "
        "and what runs as it is. Messages and services get their type support. Packages in C or C++ are refused: build "
        "them where ROS 2 is and push the install space, or write a Dockerfile FROM rce/base with a compiler in it.",
    )
    build.add_argument("directory", type=Path, metavar="DIR")
    build.add_argument(
        "--name", default="", help="name of the image (default: users/NAME, or users/USER/NAME with --for)"
    )
    build.add_argument("--from", dest="base", default=MAPPING, help="image to build on (default: %(default)s)")
    build.add_argument(
        "--for", dest="user", default="", metavar="USER", help="allow USER of a Master on this machine to run it"
    )
    build.add_argument("--data-dir", default="", help="data directory of that Master, as for `rce user`")
    return whole


def make_context(directory: Path) -> tuple[str, bytes]:
    """Return the name of the package or workspace in a directory, and the build context as a tar archive.

    Raises:
        InvalidRequest: The packages cannot be installed in an image.
        NotFound: There is no package.
    """
    found = layout.read(directory, as_is=True)
    roots = {entry.path.partition("/")[0]: None for entry in found.entries}
    if "share" in roots:
        raise InvalidRequest(f"{directory} is an install space: push it with `rce package push`")
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w", format=tarfile.PAX_FORMAT) as archive:
        for name in ("Dockerfile", "install.py"):
            add_file(archive, USER_IMAGE / name, name)
        bundle = host_bundle()
        if bundle is not None:
            add_text(archive, bundle.read_bytes(), "certificates/ca-certificates.crt")
        for package in roots:
            _add_package(archive, package, [entry for entry in found.entries if entry.path.startswith(f"{package}/")])
        if found.interfaces:
            _add_types(archive, found.interfaces)
    return found.name, buffer.getvalue()


def _add_package(archive: tarfile.TarFile, package: str, entries: list[Entry]) -> None:
    files = {entry.path.partition("/")[2]: entry.source for entry in entries}
    compiled = sorted(name for name in files if Path(name).suffix in layout.COMPILED)
    if compiled:
        raise InvalidRequest(
            f"{package} has {compiled[0]}, and the images have no compiler: build it with colcon where ROS 2 is and "
            "push its install space, or write a Dockerfile FROM rce/base with a compiler in it"
        )
    by_pip = any(name in files for name in BUILT_BY_PIP)
    for name, source in files.items():
        add_file(archive, source, f"sources/{package}/{name}" if by_pip else f"prefix/share/{package}/{name}")
        place, _, program = name.rpartition("/")
        if not by_pip:  # programs find files in their directory
            add_file(archive, source, f"prefix/lib/{package}/{name}")
            if place in (*PROGRAMS, package):
                add_file(archive, source, f"prefix/lib/{package}/{program}")
        elif name.split("/")[0] in layout.INTERFACES:
            add_file(archive, source, f"prefix/share/{package}/{name}")


def _add_types(archive: tarfile.TarFile, interfaces: list[Path]) -> None:
    with tempfile.TemporaryDirectory() as directory:
        copies = [layout.copy_interfaces(path, Path(directory)) for path in interfaces]
        prefix = typesupport.build([*typesupport.dependencies(copies), *copies]).prefix
        for entry in layout.type_support(prefix, copies):
            add_file(archive, entry.source, f"types/modules/{entry.path.partition('/')[2]}")
    add_text(archive, sysconfig.get_python_version().encode(), "types/python")


def build(directory: Path, name: str, base: str, user: str) -> str:
    """Build the image and return its name without the tag, which is the platform's version.

    Raises:
        InvalidRequest: The packages or the name are not valid.
        StartFailed: The build failed.
    """
    found, context = make_context(directory)
    name = name or "/".join(filter(None, ["users", user, found])).lower()
    if not _REPOSITORY.fullmatch(name):
        raise InvalidRequest(
            f"{name!r} is not a valid name of an image: use lower-case letters and digits, with . _ - / between them"
        )
    try:
        builder = Builder(docker.APIClient(**docker.utils.kwargs_from_env(), version="auto", timeout=600))
        builder.make(context, "Dockerfile", f"{name}:{__version__}", {"BASE": _tagged(base)})
    except (DockerException, APIError) as error:
        raise StartFailed(f"the image was not built: {error}") from None
    return name


def _tagged(image: str) -> str:
    return image if ":" in image.rpartition("/")[2] else f"{image}:{__version__}"


def allow(name: str, user: str, data_dir: str) -> None:
    """Allow a user to run the image.

    Raises:
        NotFound: The Master refused, for example because there is no such user.
    """
    words = [*programs.command("user"), *(["--data-dir", data_dir] if data_dir else [])]
    done = subprocess.run([*words, "limits", user, f"images+={name}"], capture_output=True, text=True, check=False)
    if done.returncode:
        raise NotFound(f"{name} is built, but {user} may not run it yet: {done.stderr.strip()}")


def main() -> int:
    """Run the program and return its exit status."""
    words = parser().parse_args()
    try:
        name = build(words.directory, words.name, words.base, words.user)
        if words.user:
            allow(name, words.user, words.data_dir)
    except RceError as error:
        print(f"rce image: {error}", file=sys.stderr)
        return 1
    print(name)
    if not words.user:
        print(f"to allow a user to run it: rce user limits USER images+={name}", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
