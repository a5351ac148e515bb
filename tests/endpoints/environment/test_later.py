"""Modules that are loaded when something in them is asked for."""

from __future__ import annotations

import subprocess
import sys


def run(*lines: str) -> str:
    code = "\n".join(["import sys", "from endpoints.environment.later import load_later", *lines])
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.strip()


def test_it_is_loaded_at_its_first_use_and_the_same_for_all() -> None:
    assert run(
        *('load_later("wave")', "import wave as one", "import wave as two", "late = type(one).__name__"),
        *("one.Error", "import wave as three", "print(late, one.Error is three.Error, type(three).__name__)"),
    ) == "Later True module"  # fmt: skip


def test_what_is_loaded_already_stays() -> None:
    assert run("import wave", 'load_later("wave")', "print(type(sys.modules['wave']).__name__)") == "module"


def test_a_package_whose_part_is_imported_first() -> None:
    assert run('load_later("xml")', "import xml.dom", "print(xml.dom.Node.ELEMENT_NODE)") == "1"


def test_an_attribute_that_is_none_is_an_error() -> None:
    assert run('load_later("wave")', "import wave", "print(hasattr(wave, 'nothing'))") == "False"
