"""TypeScript declarations of the JavaScript client: they compile, and match the client and the protocol."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from typing import Any

import pytest
from msgspec.structs import fields

from rce.protocol.messages import ContainerData
from tests.support.paths import ROOT

pytestmark = pytest.mark.slow  # runs the TypeScript compiler

DECLARATIONS = (ROOT / "rce" / "js" / "rce.d.ts").read_text()
NETWORK = 120.0  # seconds


@pytest.fixture(scope="module")
def compiler(tmp_path_factory: pytest.TempPathFactory) -> str:
    """TypeScript compiler, from PATH or npm."""
    present = shutil.which("tsc")
    if present:
        return present
    npm = shutil.which("npm")
    if npm is None:
        pytest.skip("needs TypeScript: install npm or tsc")
    place = tmp_path_factory.mktemp("typescript")
    words = [npm, "install", "--no-audit", "--no-fund", "--prefix", str(place), "typescript"]
    try:
        done = subprocess.run(words, capture_output=True, text=True, timeout=NETWORK)
    except subprocess.TimeoutExpired:
        pytest.skip("the npm registry does not answer")
    if done.returncode:
        pytest.skip(f"npm cannot install TypeScript: {done.stderr[-200:]}")
    return str(place / "node_modules" / ".bin" / "tsc")


def test_example_compiles(compiler: str) -> None:
    words = ["--strict", "--noEmit", "--target", "es2022", "--lib", "es2022,dom", "--module", "nodenext"]
    example = str(ROOT / "tests" / "js" / "example.ts")
    done = subprocess.run([compiler, *words, example], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stdout


def test_declared_members_exist() -> None:
    node = shutil.which("node")
    if node is None:
        pytest.skip("needs Node.js: install nodejs")
    words = [node, str(ROOT / "tests" / "js" / "members.mjs")]
    found = json.loads(subprocess.run(words, capture_output=True, text=True, timeout=60, check=True).stdout)
    assert set(found["errors"]) == set(re.findall(r"export class (\w+) extends (?!Error)", DECLARATIONS))
    for kind, present in found["members"].items():
        declared = set(_members("class", kind))
        assert declared, kind
        assert declared <= set(present), kind


def test_environment_options_are_those_of_the_protocol() -> None:
    known = {each.encode_name for each in fields(ContainerData)} - {"groupIp"}  # an alternative spelling
    assert set(_members("interface", "EnvironmentOptions")) == known


def _members(what: str, name: str) -> list[Any]:
    match = re.search(rf"^export {what} {name}\b[^\n]*{{\n(.*?)^}}", DECLARATIONS, re.S | re.M)
    assert match
    return [each for each in re.findall(r"^  (?:readonly )?(\w+)[?]?[<(:]", match[1], re.M) if each != "constructor"]
