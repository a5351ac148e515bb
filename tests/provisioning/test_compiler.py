"""Compiler and linker of generated code, with real compilers."""

from __future__ import annotations

import ctypes
import shutil
import sysconfig
from pathlib import Path

import pytest

from provisioning import compiler as module
from provisioning.compiler import Compiler
from rce.errors import InternalError, NotFound


@pytest.fixture
def tools(compiler: None, tmp_path: Path) -> Compiler:
    (tmp_path / "include").mkdir()
    (tmp_path / "include" / "answer.h").write_text("#define ANSWER 42\n")
    return Compiler([tmp_path / "include"])


def test_c_and_cpp_are_compiled_and_linked(tools: Compiler, tmp_path: Path) -> None:
    sources = [tmp_path / name for name in ("one.c", "two.cpp", "three.cpp")]
    sources[0].write_text('#include "answer.h"\nint one(void) { return ANSWER; }\n')
    sources[1].write_text('extern "C" int one(void);\nextern "C" int two() { return one() + 1; }\n')
    sources[2].write_text('extern "C" int three() { return two() + 1; }\n')  # `two` is known: C++ is compiled as one
    objects = tools.compile(sources)
    assert [path.name for path in objects] == ["joined.cpp.o", "one.c.o"]
    tools.link(tmp_path / "both.so", objects, [], [])
    assert ctypes.CDLL(str(tmp_path / "both.so")).three() == 44


def test_libraries_are_found_relative_to_the_one_that_needs_them(tools: Compiler, tmp_path: Path) -> None:
    for name, text in {
        "low": "int low(void) { return 7; }\n",
        "top": "int low(void);\nint top(void) { return low(); }\n",
    }.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / f"{name}.c").write_text(text)
    low, top = (tmp_path / name / f"{name}.so" for name in ("low", "top"))
    tools.link(low, tools.compile([low.with_suffix(".c")]), [], [])
    tools.link(top, tools.compile([top.with_suffix(".c")]), [], [low])
    moved = tmp_path / "moved"
    moved.mkdir()
    for name in ("low", "top"):
        (tmp_path / name).rename(moved / name)
    assert ctypes.CDLL(str(moved / "top" / "top.so")).top() == 7


def test_error_has_the_output_of_the_compiler(tools: Compiler, tmp_path: Path) -> None:
    (tmp_path / "bad.c").write_text("int bad(void) { return nothing; }\n")
    with pytest.raises(InternalError, match=r"bad\.c(?s:.)*failed with status 1(?s:.)*nothing"):
        tools.compile([tmp_path / "bad.c"])


def test_library_that_does_not_exist_is_an_error(tools: Compiler, tmp_path: Path) -> None:
    with pytest.raises(InternalError, match="no_such_library"):
        tools.link(tmp_path / "a.so", [], [], ["no_such_library"])


def test_compiler_of_the_environment_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CXX", raising=False)
    monkeypatch.setattr(shutil, "which", lambda name: f"/usr/bin/{name}")
    assert module.program("CXX", "g++") == ["g++"]
    monkeypatch.setenv("CXX", "ccache 'my g++' -m64")
    assert module.program("CXX", "g++") == ["ccache", "my g++", "-m64"]


def test_missing_compiler_is_reported_with_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(NotFound, match="no compiler no-such-compiler: install g"):
        Compiler([])


def test_missing_headers_of_python_are_reported(
    compiler: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sysconfig, "get_path", lambda name: str(tmp_path))
    with pytest.raises(NotFound, match=r"Python\.h is missing: install python3\.\d+-dev"):
        Compiler([])
