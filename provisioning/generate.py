"""Generator of the C, C++ and Python code of an interface package, by the generators of rosidl.

The ROS 2 wheels contain them. They are called directly, because CMake and ament do no more than pass arguments to them.
"""

from __future__ import annotations

import contextlib
import io
import json
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import rosidl_generator_c  # type: ignore[import-untyped]
import rosidl_generator_py  # type: ignore[import-untyped]
import rosidl_generator_type_description  # type: ignore[import-untyped]
import rosidl_typesupport_c  # type: ignore[import-untyped]
import rosidl_typesupport_fastrtps_c  # type: ignore[import-untyped]
import rosidl_typesupport_introspection_c  # type: ignore[import-untyped]
from rosidl_adapter.action import convert_action_to_idl
from rosidl_adapter.msg import convert_msg_to_idl
from rosidl_adapter.srv import convert_srv_to_idl
from rosidl_cli.command.helpers import generate_visibility_control_file  # type: ignore[import-untyped]

from provisioning import rosinstall
from provisioning.definitions import Package
from rce.errors import InternalError

FASTRTPS = "rosidl_typesupport_fastrtps_c"
INTROSPECTION = "rosidl_typesupport_introspection_c"
CODE = ("rosidl_generator_c", FASTRTPS, INTROSPECTION, "rosidl_typesupport_c")
PACKAGES = ("rosidl_generator_type_description", *CODE, "rosidl_generator_py")
"""Packages of the generators, which the generated code depends on beside the definitions."""

TO_IDL = {".msg": convert_msg_to_idl, ".srv": convert_srv_to_idl, ".action": convert_action_to_idl}


@dataclass(frozen=True)
class Code:
    """Generated sources, by library.

    Attributes:
        messages: Messages and their serialization.
        introspection: Descriptions of the messages.
        python: Extension module for Python.
    """

    messages: list[Path]
    introspection: list[Path]
    python: list[Path]


def generate(package: Package, python: Path, share: Path, work: Path) -> Code:
    """Generate the code of a package.

    Args:
        package: The package, whose definitions were checked.
        python: Directory for Python code, in a directory of the package's name.
        share: Directory for definitions, likewise. It has those of dependencies that are not installed.
        work: Directory for everything else, in directories GENERATOR/NAME.

    Raises:
        InternalError: A generator failed, which is a defect, since the definitions were checked.
    """
    output = io.StringIO()
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(output):
        try:
            write_definitions(package, share / package.name)
            write_code(package, python / package.name, share, work)
        except Exception as error:  # the generators have no error class of their own
            raise InternalError(f"code generation for {package.root} failed: {error}\n{output.getvalue()}") from error
    return Code(
        [source for name in CODE if name != INTROSPECTION for source in sources(work / name / package.name)],
        sources(work / INTROSPECTION / package.name),
        sources(python / package.name),
    )


def sources(directory: Path) -> list[Path]:
    """Return the C and C++ sources in a directory and below it."""
    return sorted(path for path in directory.rglob("*") if path.suffix in (".c", ".cpp"))


def write_definitions(package: Package, share: Path) -> None:
    """Write manifest and definitions of a package, the latter also as IDL."""
    share.mkdir(parents=True)
    shutil.copy(package.root / "package.xml", share)
    for interface in package.interfaces:
        target = share / interface.path
        target.parent.mkdir(exist_ok=True)
        shutil.copy(package.root / interface.path, target)
        TO_IDL[target.suffix](share.absolute(), package.name, interface.path, target.parent)


def write_code(package: Package, python: Path, share: Path, work: Path) -> None:
    """Run all generators for a package whose definitions are in `share`."""
    python.mkdir(parents=True)
    (python / "__init__.py").touch()
    outputs = {name: work / name / package.name for name in CODE}
    for name, output in outputs.items():
        prepare(name, package.name, output)
    outputs |= {"rosidl_generator_type_description": share / package.name, "rosidl_generator_py": python}
    run_generators(generator_arguments(package, share), outputs)


def prepare(generator: str, package: str, output: Path) -> None:
    """Make the directory of a generator, with the header of symbols' visibility, which no generator writes."""
    output.mkdir(parents=True)
    if package.lower() != package:  # the generated code includes its headers in lower case
        output.with_name(package.lower()).symlink_to(package)
    header = f"{generator}__visibility_control.h"
    template = rosinstall.required(generator) / "resource" / f"{header}.in"
    if template.exists():
        target = output / "msg" / header
        generate_visibility_control_file(package_name=package, template_path=template, output_path=target)


def generator_arguments(package: Package, share: Path) -> dict[str, str | list[str]]:
    """Return the arguments that all generators have in common; each uses some of them."""
    own = share / package.name
    known = rosinstall.interface_packages() | {path.name: path for path in share.iterdir()}
    idls = [interface.path.with_suffix(".idl") for interface in package.interfaces]
    return {
        "package_name": package.name,
        "idl_tuples": [f"{own}:{idl}" for idl in idls],
        "include_paths": [f"{name}:{path}" for name, path in known.items()],
        "type_description_tuples": [f"{idl}:{own / idl.with_suffix('.json')}" for idl in idls],
        "ros_interface_files": [str(own / interface.path) for interface in package.interfaces],
        "target_dependencies": [],
    }


def run_generators(arguments: dict[str, str | list[str]], outputs: dict[str, Path]) -> None:
    """Run all generators, each with its own output directory."""

    def run(package: str, generator: Callable[..., object], *more: list[str]) -> None:
        output = outputs[package]
        own = {"template_dir": str(rosinstall.required(package) / "resource"), "output_dir": str(output)}
        with tempfile.NamedTemporaryFile("w", suffix=".json") as file:
            json.dump(arguments | own, file)
            file.flush()
            generator(file.name, *more)

    run("rosidl_generator_type_description", rosidl_generator_type_description.generate_type_hash)
    run("rosidl_generator_c", rosidl_generator_c.generate_c)
    run(FASTRTPS, rosidl_typesupport_fastrtps_c.generate_typesupport_fastrtps_c)
    run(INTROSPECTION, rosidl_typesupport_introspection_c.generate_c)
    run("rosidl_typesupport_c", rosidl_typesupport_c.generate_c, [FASTRTPS, INTROSPECTION])
    run("rosidl_generator_py", rosidl_generator_py.generate_py, ["rosidl_typesupport_c"])
