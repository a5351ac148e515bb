"""Installs a user's ROS packages in the build of an image; `rce image build` has copied them to this directory.

`prefix/` is merged into the environment's prefix. `types/` (type support, built for the Python version in
`types/python`) is merged into the Python modules. Each directory in `sources/` is installed by pip, and its console
scripts become executables of the ROS package.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import sysconfig
from importlib.metadata import distribution
from pathlib import Path


def install(here: Path, prefix: Path, modules: Path) -> None:
    """Install what `here` contains into a prefix and a directory of Python modules."""
    if (here / "types").is_dir():
        built_for = (here / "types" / "python").read_text()
        if built_for != sysconfig.get_python_version():
            sys.exit(f"type support was built for Python {built_for}; this image has {sysconfig.get_python_version()}")
        shutil.copytree(here / "types" / "modules", modules, dirs_exist_ok=True)
    if (here / "prefix").is_dir():
        shutil.copytree(here / "prefix", prefix, dirs_exist_ok=True)
    for source in sorted(here.glob("sources/*")):
        _install_source(source, prefix)


def _install_source(source: Path, prefix: Path) -> None:
    command = [sys.executable, "-m", "pip", "install", "--no-cache-dir", "--quiet", "--report", "-", str(source)]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode:
        sys.exit(f"pip could not install {source.name}")
    names = [item["metadata"]["name"] for item in json.loads(done.stdout)["install"] if item["requested"]]
    (prefix / "share" / source.name).mkdir(parents=True, exist_ok=True)
    shutil.copy(source / "package.xml", prefix / "share" / source.name)
    executables = prefix / "lib" / source.name
    executables.mkdir(parents=True, exist_ok=True)
    for entry in (entry for name in names for entry in distribution(name).entry_points):
        if entry.group == "console_scripts" and not (executables / entry.name).exists():
            (executables / entry.name).symlink_to(Path(sys.executable).with_name(entry.name))


if __name__ == "__main__":
    install(Path(__file__).parent, Path(sys.prefix), Path(sysconfig.get_path("purelib")))
