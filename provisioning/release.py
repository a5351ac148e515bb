"""RCE's code in the system: releases side by side under /opt/rce, and a link to the one that runs.

So an upgrade that fails changes nothing, what runs keeps its files, and the way back is the link.
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

from provisioning.steps import ROOT, Failed, Step, run
from provisioning.system import CURRENT, DOCKER, OPT, System, public_python

PACKAGES = ("rce", "master", "endpoints", "containers", "converters", "provisioning")
FILES = ("pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md")
KEPT = 2  # releases: the running one and the one before, whose files environments may still use
EXTRAS = {"master": ("server",), "robot": ("server",), "container": ("server",), "map-service": ("server", "mapping")}
TYPESUPPORT = f"{OPT}/typesupport"
SOURCE = "source.tar.gz"  # of a release, which machines to come may fetch from the Master


def extras(roles: Collection[str], engine: str) -> list[str]:
    """Of our package, for these roles."""
    wanted = {extra for role in roles for extra in EXTRAS[role]}
    if "container" in roles:
        wanted |= {"docker"} if engine in DOCKER else {"ros", "mapping"}
    return sorted(wanted)


def sources() -> Iterator[Path]:
    """The files of the checkout that make a release."""
    for name in FILES:
        yield ROOT / name
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*")):
            if path.is_file() and "__pycache__" not in path.parts:
                yield path


def name_of(wanted: Collection[str]) -> str:
    """The version, and a digest of the code and of the extras: another name means another release."""
    digest = hashlib.sha256(" ".join(sorted(wanted)).encode())
    for path in sources():
        digest.update(f"\0{path.relative_to(ROOT)}\0".encode())
        digest.update(path.read_bytes())
    found = re.search(r'^version = "(.+)"$', (ROOT / "pyproject.toml").read_text(), re.MULTILINE)
    return f"{found[1] if found else '0'}-{digest.hexdigest()[:12]}"


def release_steps(system: System, wanted: Collection[str]) -> list[Step]:
    """Put the checkout's code there as a release of its own; what runs does not notice."""
    name = name_of(wanted)
    place = f"{OPT}/releases/{name}"
    listed = f"rce[{','.join(sorted(wanted))}]"
    done = system.path(f"{place}/{SOURCE}").exists()  # what is made last
    return [
        Step(
            "release",
            lambda: "" if done else f"build a wheel of this checkout, install {listed} in {place}",
            lambda: _make(place, sorted(wanted)),
        )
    ]


def switch_step(system: System, wanted: Collection[str]) -> Step:
    """Let the services' next start be of the checkout's release."""
    target = f"releases/{name_of(wanted)}"
    link = system.path(CURRENT)
    done = link.is_symlink() and os.readlink(link) == target
    return Step("current release", lambda: "" if done else f"{CURRENT} -> {target}", lambda: _switch(link, target))


def _make(place: str, wanted: list[str]) -> str:
    directory = Path(place)
    shutil.rmtree(directory, ignore_errors=True)
    directory.mkdir(parents=True)
    python = directory / "bin" / "python"
    try:
        run(public_python(), "-m", "venv", directory)
        quiet = ("--disable-pip-version-check", "--no-input")
        run(python, "-m", "pip", "wheel", *quiet, "--no-deps", "--wheel-dir", directory / "wheel", ROOT)
        (wheel,) = (directory / "wheel").glob("*.whl")
        run(python, "-m", "pip", "install", *quiet, "--no-compile", f"{wheel}[{','.join(wanted)}]")
        # Services may not write there. Libraries' own tests, half of all code, nobody runs.
        run(python, "-m", "compileall", "-q", "-j", "0", "-x", "/tests?/", directory / "lib")
        _pack(directory / SOURCE)
    except BaseException:
        shutil.rmtree(directory, ignore_errors=True)
        raise
    return directory.name


def _pack(archive: Path) -> None:
    """The checkout without its history and what was built in it."""
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
    """Types that the ROS 2 wheels lack, for environments outside of images. Releases share them: they take a minute."""

    def build() -> str:
        if shutil.which("g++") is None:
            raise Failed("type support needs a compiler: apt-get install g++ python3-dev")
        command = (f"{CURRENT}/bin/python", "-P", "-m", "provisioning.typesupport", "--cache", TYPESUPPORT)
        return run(*command).strip().splitlines()[-1]

    return Step("type support", lambda: f"build in {TYPESUPPORT} what is not there yet", build)


def version_of(system: System) -> str:
    """What runs here, as `0.1.0-…`; empty if nothing is installed."""
    link = system.path(CURRENT)
    return Path(os.readlink(link)).name if link.is_symlink() else ""


def python_has(python: str, module: str) -> bool:
    return subprocess.run([python, "-c", f"import {module}"], stderr=subprocess.DEVNULL).returncode == 0
