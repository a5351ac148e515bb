"""Users' nodes do not see RCE's packages, and may have modules of the same names."""

from __future__ import annotations

import os
import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.support.paths import ROOT

NODEPATH = ROOT / "endpoints" / "environment" / "nodepath"


@pytest.fixture
def module(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Names in the module, whose finder is not active in this process after the test."""
    monkeypatch.setattr(sys, "meta_path", list(sys.meta_path))
    return runpy.run_path(str(NODEPATH / "sitecustomize.py"))


def run(code: str, *path: Path) -> str:
    """Run code as a node runs: with RCE's checkout, the node path and these directories on its path."""
    variables = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, (NODEPATH, ROOT, *path)))}
    done = subprocess.run(
        [sys.executable, "-P", "-c", code], env=variables, capture_output=True, text=True, check=True, cwd=ROOT
    )
    return done.stdout.strip()


def test_packages_of_rce_are_hidden(module: dict[str, Any]) -> None:
    code = (
        f"import importlib\nfor name in {sorted(module['OURS'])}:\n"
        "    try:\n        print(name, importlib.import_module(name))\n"
        "    except ModuleNotFoundError as error:\n        assert error.name == name\n"
        "import msgspec, json"
    )
    assert run(code) == ""


def test_modules_of_user_with_same_names_are_found(tmp_path: Path) -> None:
    (tmp_path / "converters").mkdir()
    (tmp_path / "converters" / "__init__.py").touch()
    (tmp_path / "converters" / "wire.py").write_text("OWNER = 'the user'")
    (tmp_path / "tests.py").write_text("OWNER = 'the user, too'")
    code = "import converters.wire, tests\nprint(converters.wire.OWNER, tests.OWNER, sep=', ')"
    assert run(code, tmp_path) == "the user, the user, too"


def test_all_packages_of_checkout_are_hidden(module: dict[str, Any]) -> None:
    packages = {path.parent.name for path in ROOT.glob("*/__init__.py")}
    assert packages <= module["OURS"]


def test_submodules_and_other_modules_are_left_to_python(module: dict[str, Any]) -> None:
    hider = module["Hider"]()
    assert hider.find_spec("json") is None
    assert hider.find_spec("rce", ["/some/where"]) is None


def test_directory_of_rce_is_skipped_by_any_of_its_names(
    module: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(sys, "path", ["", str(ROOT), str(ROOT / "rce" / "..")])
    with pytest.raises(ModuleNotFoundError, match="rce"):
        module["Hider"]().find_spec("rce")
