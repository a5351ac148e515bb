"""Code that the generators of ROS 2 write for a package."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from provisioning import generate
from provisioning.definitions import Package, read_packages
from rce.errors import InternalError
from tests.support.provisioning.packages import write_package

MakePackage = Callable[..., Path]
FILES = {"msg/Part.msg": "int32 a\n", "msg/Whole.msg": "Part[] parts\nstd_msgs/Header header\n", "srv/Do.srv": "---\n"}


class Generated:
    """Result of a generation, and the directories that it is in."""

    def __init__(self, package: Package, root: Path) -> None:
        self.python, self.share, self.work = (root / name for name in ("python", "share", "work"))
        self.code = generate.generate(package, self.python, self.share, self.work)


@pytest.fixture(scope="module")
def generated(tmp_path_factory: pytest.TempPathFactory) -> Generated:
    root = tmp_path_factory.mktemp("generated")
    [package] = read_packages([write_package(root / "Own", "Own", FILES)])
    return Generated(package, root / "out")


def test_definitions_are_installed_also_as_idl_with_hashes(generated: Generated) -> None:
    share = generated.share / "Own"
    assert (share / "package.xml").exists()
    assert sorted(path.name for path in (share / "msg").iterdir()) == [
        f"{name}.{kind}" for name in ("Part", "Whole") for kind in ("idl", "json", "msg")
    ]
    hashes = json.loads((share / "srv" / "Do.json").read_text())["type_hashes"]
    assert all(entry["hash_string"].startswith("RIHS01_") for entry in hashes)


def test_sources_are_sorted_by_the_library_that_they_belong_to(generated: Generated) -> None:
    code = generated.code
    assert {path.suffix for path in code.messages} == {".c", ".cpp"}
    assert all(generate.INTROSPECTION not in str(path) for path in code.messages)
    assert code.introspection
    assert all(generate.INTROSPECTION in str(path) for path in code.introspection)
    assert {path.suffix for path in code.python} == {".c"}
    assert all(path.is_relative_to(generated.python / "Own") for path in code.python)


def test_python_package_has_a_module_for_each_interface(generated: Generated) -> None:
    python = generated.python / "Own"
    assert (python / "__init__.py").exists()
    assert (python / "msg" / "_whole.py").exists()
    assert (python / "srv" / "_do.py").exists()


def test_headers_are_found_in_lower_case(generated: Generated) -> None:
    """The generated code includes its headers by the name of the package in lower case."""
    for name in generate.CODE:
        assert (generated.work / name / "own").resolve() == generated.work / name / "Own"


def test_package_may_use_one_that_was_generated_before(make_package: MakePackage, tmp_path: Path) -> None:
    roots = [make_package("alpha", {"msg/A.msg": "beta/B b\n"}), make_package("beta", {"msg/B.msg": "int32 b\n"})]
    for package in read_packages(roots):
        last = Generated(package, tmp_path / "out")
    assert "beta" in (last.share / "alpha" / "msg" / "A.json").read_text()


def test_failure_of_a_generator_names_the_package(
    make_package: MakePackage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        print("what the generator printed")
        raise RuntimeError("it broke")

    monkeypatch.setattr(generate, "run_generators", fail)
    [package] = read_packages([make_package("own", {"msg/A.msg": ""})])
    with pytest.raises(InternalError, match=r"own failed: it broke\n(?s:.*)what the generator printed"):
        Generated(package, tmp_path / "out")
