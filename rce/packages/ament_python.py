"""Installation of ROS packages of the build type `ament_python` into a prefix, as `colcon build` leaves them."""

from __future__ import annotations

import ast
import configparser
import shutil
import subprocess
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from xml.etree import ElementTree

from rce.errors import InvalidRequest, StartFailed

LAST_LINES = 20  # of pip's output, in an error


def install(directory: Path, scratch: Path) -> Path:
    """Install the packages of a directory, if they have the build type ament_python.

    Args:
        directory: A package, or a directory with packages.
        scratch: An empty directory.

    Returns:
        The prefix, below `scratch`; or `directory`, if it has no such package.

    Raises:
        InvalidRequest: It has packages of other build types too, or an entry point that starts nothing.
        StartFailed: pip cannot install a package.
    """
    directory = directory.expanduser().resolve()
    found = (
        [directory]
        if (directory / "package.xml").is_file()
        else sorted(p.parent for p in directory.glob("*/package.xml"))
    )
    ours = [package for package in found if (package / "setup.py").is_file() and _build_type(package) == "ament_python"]
    if not ours:
        return directory
    if others := [package.name for package in found if package not in ours]:
        raise InvalidRequest(
            f"{', '.join(others)} cannot be pushed together with packages of the type ament_python: push each by itself"
        )
    prefix = scratch / directory.name / "install"
    for package in ours:
        _install(package, prefix, scratch / "sources")
    return prefix


def _build_type(package: Path) -> str:
    try:
        return (ElementTree.parse(package / "package.xml").getroot().findtext("export/build_type") or "").strip()
    except ElementTree.ParseError:
        return ""  # the reader of the package reports it


def _install(package: Path, prefix: Path, sources: Path) -> None:
    copy = sources / package.name  # setuptools writes into the directory
    shutil.copytree(package, copy, ignore=shutil.ignore_patterns("build", "*.egg-info", "__pycache__", ".*"))
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-compile", "--ignore-installed"]
    command += ["--no-build-isolation"] if find_spec("setuptools") is not None else []
    done = subprocess.run([*command, f"--prefix={prefix}", str(copy)], capture_output=True, text=True, check=False)
    if done.returncode:
        last = "\n".join((done.stdout + done.stderr).strip().splitlines()[-LAST_LINES:])
        raise StartFailed(f"pip cannot install {package.name}:\n{last}")
    name = (ElementTree.parse(package / "package.xml").getroot().findtext("name") or "").strip()
    share, executables = prefix / "share" / name, prefix / "lib" / name
    share.mkdir(parents=True, exist_ok=True)
    shutil.copy(package / "package.xml", share)
    executables.mkdir(parents=True, exist_ok=True)
    modules = next(prefix.glob("lib/python*/site-packages"), prefix)
    for script, target in _entry_points(modules, {path.name for path in prefix.glob("bin/*")}):
        _check_starts(name, modules, script, target)
    for path in prefix.glob("bin/*"):
        path.rename(executables / path.name)


def _entry_points(modules: Path, scripts: set[str]) -> Iterator[tuple[str, str]]:
    """Yield name and target (`module:function`) of the console scripts that were just installed."""
    for path in modules.glob("*.dist-info/entry_points.txt"):
        parser = configparser.ConfigParser(delimiters=("=",))
        parser.optionxform = str  # type: ignore[assignment, method-assign]  # names keep their case
        parser.read(path)
        if parser.has_section("console_scripts"):
            yield from ((name, target) for name, target in parser["console_scripts"].items() if name in scripts)


def _check_starts(package: str, modules: Path, script: str, target: str) -> None:
    """Check that the function of an entry point exists, without running the module.

    Raises:
        InvalidRequest: It does not.
    """
    module, _, function = target.partition(":")
    base = modules / Path(*module.split("."))
    path = base.with_suffix(".py") if base.with_suffix(".py").is_file() else base / "__init__.py"
    where = f"entry point {script} of {package} starts {target}, which does not exist"
    if not path.is_file():
        raise InvalidRequest(
            f"{where}: there is no module {module} among the installed files: see `packages` in setup.py"
        )
    if function.partition(".")[0] not in set(_names(ast.parse(path.read_text(), str(path)))):
        raise InvalidRequest(f"{where}: {module} has no {function}")


def _names(tree: ast.Module) -> Iterator[str]:
    """Yield the names that a module defines or imports, also within `if` and `try`."""
    for node in ast.walk(tree):
        match node:
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.ClassDef(name=name):
                yield name
            case ast.alias(name=name, asname=alias):
                yield alias or name.partition(".")[0]
            case ast.Name(id=name, ctx=ast.Store()):
                yield name
