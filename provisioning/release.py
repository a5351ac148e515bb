"""Releases of RCE's code, side by side under /opt/rce, and a link to the current one.

An upgrade that fails changes nothing, running services keep their files, and a rollback is a change of the link.
Standard library only.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import subprocess
import tarfile
from collections.abc import Collection, Iterator
from pathlib import Path

from provisioning.steps import ROOT, ProvisioningError, Step, pip_environment, pip_install, run
from provisioning.system import CURRENT, DOCKER, OPT, System, public_python

PACKAGES = ("rce", "master", "endpoints", "containers", "converters", "provisioning")
FILES = ("pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md")
KEPT = 2  # releases: the current one and the previous, whose files environments may still use
EXTRAS = {
    "master": ("server",),
    "robot": ("server",),
    "container": ("server",),
    "map-service": ("server", "mapping"),
    "knowledge-service": ("server", "knowledge"),
}
TYPESUPPORT = f"{OPT}/typesupport"
SOURCE = "source.tar.gz"  # the release's source, which new machines can fetch from the Master


def required_extras(roles: Collection[str], engine: str, database: str = "") -> list[str]:
    """Return the extras of RCE that these roles need; `database` is the URL of the Master's."""
    extras = {extra for role in roles for extra in EXTRAS[role]}
    if "container" in roles:
        extras |= {"docker"} if engine in DOCKER else {"ros", "mapping", "mapping3d"}
    if "master" in roles and database.startswith("postgresql"):
        extras.add("postgresql")
    return sorted(extras)


def sources() -> Iterator[Path]:
    """Yield the files of the checkout that are part of a release."""
    for name in FILES:
        yield ROOT / name
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*")):
            if path.is_file() and "__pycache__" not in path.parts:
                yield path


def release_name(extras: Collection[str]) -> str:
    """Return the name of the checkout's release: the version, and a digest of the code and of the extras."""
    digest = hashlib.sha256(" ".join(sorted(extras)).encode())
    for path in sources():
        digest.update(f"\0{path.relative_to(ROOT)}\0".encode())
        digest.update(path.read_bytes())
    found = re.search(r'^version = "(.+)"$', (ROOT / "pyproject.toml").read_text(), re.MULTILINE)
    return f"{found[1] if found else '0'}-{digest.hexdigest()[:12]}"


def release_steps(system: System, extras: Collection[str]) -> list[Step]:
    """Return the steps that install the checkout as a new release. They do not affect running services."""
    name = release_name(extras)
    place = f"{OPT}/releases/{name}"
    listed = f"rce[{','.join(sorted(extras))}]"
    done = system.path(f"{place}/{SOURCE}").exists()  # it is written last
    return [
        Step(
            "release",
            lambda: "" if done else f"build a wheel of this checkout, install {listed} in {place}",
            lambda: _make(place, sorted(extras)),
        )
    ]


def switch_step(system: System, extras: Collection[str]) -> Step:
    """Return the step that makes the checkout's release the current one, which services use after a restart."""
    target = f"releases/{release_name(extras)}"
    link = system.path(CURRENT)
    done = link.is_symlink() and os.readlink(link) == target
    return Step("current release", lambda: "" if done else f"{CURRENT} -> {target}", lambda: _switch(link, target))


def _make(place: str, extras: list[str]) -> str:
    directory = Path(place)
    shutil.rmtree(directory, ignore_errors=True)
    directory.mkdir(parents=True)
    python = directory / "bin" / "python"
    try:
        run(public_python(), "-m", "venv", directory)
        build = (python, "-m", "pip", "wheel", "--disable-pip-version-check", "--no-input", "--no-deps")
        run(*build, "--wheel-dir", directory / "wheel", ROOT, environment=pip_environment())
        (wheel,) = (directory / "wheel").glob("*.whl")
        pip_install(python, "--no-compile", f"{wheel}[{','.join(extras)}]")
        # Services have no right to write there. Tests of libraries, half of all code, are not compiled.
        run(python, "-m", "compileall", "-q", "-j", "0", "-x", "/tests?/", directory / "lib")
        _pack(directory / SOURCE)
    except BaseException:
        shutil.rmtree(directory, ignore_errors=True)
        raise
    return directory.name


def _pack(archive: Path) -> None:
    """Write the archive of the sources."""
    draft = archive.with_suffix(".new")
    with tarfile.open(draft, "w:gz") as tar:
        for path in sources():
            tar.add(path, path.relative_to(ROOT).as_posix(), filter=_plain)
    draft.chmod(0o644)
    draft.rename(archive)


def _plain(info: tarfile.TarInfo) -> tarfile.TarInfo:
    info.uid = info.gid = 0
    info.uname = info.gname = "root"
    return info


def _switch(link: Path, target: str) -> str:
    new = link.with_name(".current.new")
    new.unlink(missing_ok=True)
    new.symlink_to(target)
    new.rename(link)
    releases = sorted((link.parent / "releases").iterdir(), key=lambda path: path.stat().st_mtime)
    for old in [path for path in releases if path.name != Path(target).name][: -(KEPT - 1)]:
        shutil.rmtree(old)
    return f"-> {target}"


def typesupport_step(system: System) -> Step:
    """Return the step that builds types that the ROS 2 wheels lack, for the engine `process`.

    Releases share them, because the build takes a minute.
    """

    def build() -> str:
        if shutil.which("g++") is None:
            raise ProvisioningError("type support needs a compiler: apt-get install g++ python3-dev")
        command = (f"{CURRENT}/bin/python", "-P", "-m", "provisioning.typesupport", "--cache", TYPESUPPORT)
        return run(*command).strip().splitlines()[-1]

    return Step("type support", lambda: f"build what is missing in {TYPESUPPORT}", build)


def installed_release(system: System) -> str:
    """Return the name of the current release, such as `0.1.0-…`, or "" if nothing is installed."""
    link = system.path(CURRENT)
    return Path(os.readlink(link)).name if link.is_symlink() else ""


def python_has(python: str, module: str) -> bool:
    """Return True if this Python can import the module."""
    return subprocess.run([python, "-c", f"import {module}"], stderr=subprocess.DEVNULL).returncode == 0
