"""Compiler and linker of generated C and C++ code, which becomes Python extension modules."""

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
    """The C and C++ compilers of the variables `CC` and `CXX`, by default gcc and g++.

    Raises:
        NotFound: A compiler or the headers of Python are missing.
    """

    def __init__(self, includes: Iterable[Path]) -> None:
        self.by_suffix = {".c": program("CC", "gcc"), ".cpp": program("CXX", "g++")}
        headers = Path(sysconfig.get_path("include"))
        if not (headers / "Python.h").exists():
            raise NotFound(f"{headers}/Python.h is missing: install python{sysconfig.get_python_version()}-dev")
        found = [headers, Path(np.get_include()), *includes, *rosinstall.include_directories()]
        self.flags = ["-O1", "-fPIC", *(f"-I{directory}" for directory in found)]

    def compile(self, sources: Sequence[Path]) -> list[Path]:
        """Compile sources on all cores, and return the object files, which are beside the sources.

        C++ files are compiled as one, because most of their time is spent on headers that they share.

        Raises:
            InternalError: A source does not compile. The message has the compiler's output.
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
        """Link a shared library.

        When it is loaded, libraries given by path are found relative to `target`, and installed ones by name, which the
        wheels and a system ROS 2 provide for (`LD_LIBRARY_PATH`).

        Args:
            target: The library to write.
            objects: The object files that it consists of.
            own: Libraries to link in any case.
            libraries: Libraries to link only if they define a symbol that is needed.
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
    """Return the command of a compiler: the value of an environment variable, or a default.

    Raises:
        NotFound: There is no such program.
    """
    command = shlex.split(os.environ.get(variable, "")) or [default]
    if shutil.which(command[0]) is None:
        raise NotFound(f"there is no compiler {command[0]}: install g++, or set {variable} to another compiler")
    return command


def run(command: list[str]) -> None:
    """Run a compiler.

    Raises:
        InternalError: It failed. The message has the end of its output.
    """
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    if done.returncode:
        raise InternalError(f"{shlex.join(command)}\nfailed with status {done.returncode}:\n{done.stdout[-4000:]}")
