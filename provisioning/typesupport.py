"""Builder of type support for ROS 2 messages, services and actions that the installed packages lack, with a cache.

`python -m provisioning.typesupport [DIR…]` builds the interface packages of RCE (tf2_msgs, map_msgs and others) and
those in DIR, prints the prefix with the result, and points the link `current` in the cache to it.
"""

from __future__ import annotations

import argparse
import fcntl
import hashlib
import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from provisioning import compiler, definitions, generate, rosinstall
from provisioning.definitions import Package
from rce.errors import InternalError, RceError

FORMAT = 1  # increment when the result for the same input changes
DEFAULT_CACHE = Path(sys.prefix) / "typesupport"
RUNTIME = (
    *generate.CODE[1:],
    *("rosidl_typesupport_fastrtps_cpp", "rosidl_runtime_c", "rcutils", "rmw", "fastcdr"),
)
"""Libraries of ROS 2 that generated code uses."""
GENERATED_USE = ("service_msgs", "builtin_interfaces", "action_msgs", "unique_identifier_msgs")
"""Packages that the generated code of services and actions uses."""


@dataclass(frozen=True)
class TypeSupport:
    """Result of a build.

    Attributes:
        prefix: Prefix like those of installed ROS 2 packages. In `AMENT_PREFIX_PATH` it gives access to definitions and
            nodes, and its directory `python` in `PYTHONPATH` to the modules.
        left_out: Files that are not supported: IDL.
    """

    prefix: Path
    left_out: tuple[Path, ...] = ()


def shipped() -> list[Path]:
    """Return the interface packages of RCE, without those that are installed already."""
    found = Path(__file__).with_name("interfaces").iterdir()
    return sorted(path for path in found if path.is_dir() and rosinstall.share(path.name) is None)


def dependencies(roots: Sequence[Path]) -> list[Path]:
    """Return the interface packages of RCE that the packages in these directories depend on."""
    packages = [definitions.read_package(root.absolute()) for root in roots]
    names = {reference.package for package in packages for reference in package.uses}
    return [path for path in shipped() if path.name in names - {package.name for package in packages}]


def build(roots: Sequence[Path], cache: Path = DEFAULT_CACHE) -> TypeSupport:
    """Build type support for the interface packages in these directories, or find it in the cache.

    Several processes may call it at the same time: one builds, the others wait.

    Raises:
        InvalidRequest: A file is malformed. As for the next three, the message has file and line.
        InvalidName: The name of a package or type is not legal.
        UnknownType: A message is not defined.
        AlreadyExists: A name is used twice.
        NotFound: There is no compiler, or no ROS 2.
    """
    packages = definitions.read_packages(path.absolute() for path in roots)
    prefix = cache.absolute() / cache_key(packages)
    result = TypeSupport(prefix, tuple(path for package in packages for path in package.left_out))
    if not prefix.exists():
        with lock_cache(cache) as workshop:
            if not prefix.exists():
                build_packages(packages, workshop)
                workshop.rename(prefix)
    return result


def cache_key(packages: Sequence[Package]) -> str:
    """Return a hash of everything that the result depends on: packages, dependencies, generators and Python."""
    used = {reference for package in packages for reference in package.uses}
    files = [path for package in packages for path in package.files]
    files += [rosinstall.required(name) / "package.xml" for name in (*generate.PACKAGES, *GENERATED_USE)]
    files += [
        directory / "msg" / f"{name}.json" for package, name in sorted(used) if (directory := rosinstall.share(package))
    ]
    names = [package.name for package in packages]
    digest = hashlib.sha256(repr((FORMAT, sys.version, platform.machine(), version("numpy"), names)).encode())
    for path in files:
        content = path.read_bytes()
        digest.update(f"\0{path.parent.name}/{path.name}\0{len(content)}\0".encode() + content)
    return digest.hexdigest()[:16]


@contextmanager
def lock_cache(cache: Path) -> Iterator[Path]:
    """Hold the cache's lock, which ends with the process, and yield an empty directory to build in."""
    cache.mkdir(parents=True, exist_ok=True)
    with (cache / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        workshop = cache.absolute() / ".building"
        shutil.rmtree(workshop, ignore_errors=True)
        workshop.mkdir()
        try:
            yield workshop
        finally:
            shutil.rmtree(workshop, ignore_errors=True)


def build_packages(packages: Sequence[Package], prefix: Path) -> None:
    """Build packages, given with dependencies first, into an empty directory."""
    (prefix / rosinstall.MARKER).touch()
    work, python = prefix / "work", prefix / "python"
    tools = compiler.Compiler(work / name for name in generate.CODE)
    for package in packages:
        code = generate.generate(package, python, prefix / "share", work)
        link(package, code, tools, python)
        register(package, prefix)
    shutil.rmtree(work)
    for path in (*python.rglob("*.c"), *python.rglob("*.o")):
        path.unlink()
    check_loadable(packages, python)


def libraries(package: str, python: Path) -> list[Path]:
    """Return the paths of a package's libraries: messages, introspection, Python module.

    The dispatching layer of ROS 2 loads the first two by name. That works for any directory, because the Python module
    is linked to them, so that they are loaded already.
    """
    names = (f"lib{package}__{generate.FASTRTPS}", f"lib{package}__{generate.INTROSPECTION}", module_name(package))
    return [python / package / f"{name}.so" for name in names]


def module_name(package: str) -> str:
    """Return the name of a package's extension module for Python."""
    return f"{package}_s__rosidl_typesupport_c"


def link(package: Package, code: generate.Code, tools: compiler.Compiler, python: Path) -> None:
    """Compile and link the three libraries of a package."""
    used: list[str | Path] = []
    for name in sorted({reference.package for reference in package.uses}.union(GENERATED_USE)):
        built = libraries(name, python)
        used += built if built[0].exists() else [f"{name}__{kind}" for kind in (*generate.CODE, "rosidl_generator_py")]
    used += RUNTIME
    own: list[Path] = []
    for target, sources in zip(
        libraries(package.name, python), (code.messages, code.introspection, code.python), strict=True
    ):
        tools.link(target, tools.compile(sources), own, used)
        own.append(target)


def register(package: Package, prefix: Path) -> None:
    """Add the package to the ament index, and install its nodes where `ros2 run` and RCE find them."""
    index = prefix / "share" / "ament_index" / "resource_index"
    for kind in ("packages", "rosidl_interfaces"):
        (index / kind).mkdir(parents=True, exist_ok=True)
        (index / kind / package.name).write_text("\n".join(str(item.path) for item in package.interfaces))
    for script in package.scripts:
        target = prefix / "lib" / package.name / script.name
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(script, target)


def check_loadable(packages: Sequence[Package], python: Path) -> None:
    """Load every module with all its symbols, so that only working results get into the cache.

    Raises:
        InternalError: A module cannot be loaded.
    """
    modules = [f"{package.name}.{module_name(package.name)}" for package in packages]
    kinds = sorted({f"{package.name}.{item.path.parent.name}" for package in packages for item in package.interfaces})
    path = os.pathsep.join(filter(None, (str(python), os.environ.get("PYTHONPATH"))))
    done = subprocess.run(
        [sys.executable, "-P", "-c", f"import {', '.join(modules + kinds)}"],
        env={**os.environ, "PYTHONPATH": path, "LD_BIND_NOW": "1", "PYTHONDONTWRITEBYTECODE": "1"},
        stderr=subprocess.PIPE,
        text=True,
        check=False,
    )
    if done.returncode:
        raise InternalError(f"the type support that was built cannot be loaded:\n{done.stderr}")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program and return its exit status."""
    options = argparse.ArgumentParser(prog="python -m provisioning.typesupport", description=__doc__)
    options.add_argument("package", nargs="*", type=Path, metavar="DIR", help="directory of an interface package")
    options.add_argument(
        "--cache", type=Path, default=DEFAULT_CACHE, help="directory of results (default: %(default)s)"
    )
    options.add_argument(
        "--alone",
        action="store_true",
        help="build only DIR and its dependencies, and leave the link `current` as it is",
    )
    given = options.parse_args(arguments)
    try:
        result = build([*(dependencies(given.package) if given.alone else shipped()), *given.package], given.cache)
    except RceError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    for path in result.left_out:
        print(f"left out: {path}: only .msg, .srv and .action are supported", file=sys.stderr)
    if not given.alone:
        replace_link(given.cache / "current", result.prefix)
    print(result.prefix)
    return 0


def replace_link(link: Path, target: Path) -> None:
    """Point a symbolic link to another target atomically."""
    new = link.with_name(f".{link.name}-{os.getpid()}")
    new.symlink_to(target.name)
    new.rename(link)


if __name__ == "__main__":
    sys.exit(main())
