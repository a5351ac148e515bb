"""Clients of other projects from the package registries, as they are published."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest

TIMEOUT = 120  # seconds


def source_distribution(directory: Path, name: str, version: str) -> Path:
    """Return the unpacked source distribution of a Python package, or skip the test if it cannot be had."""
    words = ["pip", "download", "--quiet", "--no-binary", ":all:", "--no-deps", "--no-build-isolation"]
    _run([sys.executable, "-m", *words, "--dest", str(directory), f"{name}=={version}"], directory, name)
    (archive,) = directory.glob("*.tar.gz")
    with tarfile.open(archive) as packed:
        packed.extractall(directory, filter="data")
    return directory / archive.name.removesuffix(".tar.gz")


def node_modules(directory: Path, *packages: str) -> Path:
    """Return a directory of these npm packages, as `name@version`, or skip the test if they cannot be had."""
    if shutil.which("npm") is None:
        pytest.skip("no npm: install it to run this")
    (directory / "package.json").write_text('{"private": true, "type": "module"}')
    options = ["--no-audit", "--no-fund", "--ignore-scripts", "--fetch-retries=1"]
    _run(["npm", "install", "--silent", *options, *packages], directory, ", ".join(packages))
    return directory / "node_modules"


def _run(words: list[str], directory: Path, what: str) -> None:
    try:
        done = subprocess.run(words, cwd=directory, capture_output=True, text=True, timeout=TIMEOUT, check=False)
    except subprocess.TimeoutExpired:
        pytest.skip(f"{what} cannot be had: the registry did not answer within {TIMEOUT} s")
    if done.returncode:
        pytest.skip(f"{what} cannot be had: {(done.stderr or done.stdout).strip()[-300:]}")
