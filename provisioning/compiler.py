"""Compiles and links generated C and C++ code into a Python extension module."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sysconfig
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from provisioning import rosinstall
from rce.errors import InternalError, NotFound


class Compiler:
    """The C and C++ compilers that `CC` and `CXX` name, else gcc and g++. Raises NotFound, with what to install."""

    def __init__(self, includes: Iterable[Path]) -> None:
        self.by_suffix = {".c": program("CC", "gcc"), ".cpp": program("CXX", "g++")}
        headers = Path(sysconfig.get_path("include"))
        if not (headers / "Python.h").exists():
            raise NotFound(f"{headers}/Python.h is missing: install python{sysconfig.get_python_version()}-dev")
        found = [headers, Path(np.get_include()), *includes, *rosinstall.include_directories()]
        self.flags = ["-O1", "-fPIC", *(f"-I{directory}" for directory in found)]

    def compile(self, sources: Sequence[Path]) -> list[Path]:
        """Object files beside the sources, all cores at work. Raises InternalError with the compiler's output.

        C++ files are compiled as one: almost all of their time goes to headers that they share.
        """
        units = [source for source in sources if source.suffix == ".c"]
        if cpp := [source for source in sources if source.suffix == ".cpp"]:
            joined = cpp[0].with_name("joined.cpp")
            joined.write_text("".join(f'#include "{source}"\n' for source in cpp))
            units.insert(0, joined)
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            return list(pool.map(self._compile, units))

    def _compile(self, source: Path) -> Path:
        target = source.with_name(source.name + ".o")
        run([*self.by_suffix[source.suffix], *self.flags, "-c", str(source), "-o", str(target)])
        return target

    def link(self, target: Path, objects: Iterable[Path], own: Sequence[Path], libraries: Iterable[str | Path]) -> None:
        """Link `target`: with the `own` libraries in any case, with the others if they have something that it lacks.

        When it is loaded, libraries by path are found by their place relative to `target`, installed ones by name, as
        the wheels and a system ROS 2 provide for (`LD_LIBRARY_PATH`).
        """
        libraries = list(libraries)
        near = [library for library in (*own, *libraries) if isinstance(library, Path)]
        run(
            [
                *self.by_suffix[".cpp"],
                *("-shared", "-s", f"-Wl,-soname,{target.name}", "-o", str(target)),
                *map(str, objects),
                *("-Wl,--no-as-needed", *map(str, own), "-Wl,--as-needed"),
                *(f"-L{prefix / 'lib'}" for prefix in rosinstall.prefixes()),
                *(str(library) if isinstance(library, Path) else f"-l{library}" for library in libraries),
                *(f"-Wl,-rpath,$ORIGIN/{os.path.relpath(library.parent, target.parent)}" for library in near),
            ]
        )


def program(variable: str, default: str) -> list[str]:
    command = shlex.split(os.environ.get(variable, "")) or [default]
    if shutil.which(command[0]) is None:
        raise NotFound(f"there is no compiler {command[0]}: install g++ or name another in {variable}")
    return command


def run(command: list[str]) -> None:
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    if done.returncode:
        raise InternalError(f"{shlex.join(command)}\nfailed with status {done.returncode}:\n{done.stdout[-4000:]}")
