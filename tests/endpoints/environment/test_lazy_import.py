"""Lazy imports."""

from __future__ import annotations

import subprocess
import sys


def run(*lines: str) -> str:
    code = "\n".join(["import sys", "from endpoints.environment.lazy_import import import_lazily", *lines])
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.strip()


def test_module_is_loaded_at_first_use_for_all_importers() -> None:
    assert run(
        *('import_lazily("wave")', "import wave as one", "import wave as two", "late = type(one).__name__"),
        *("one.Error", "import wave as three", "print(late, one.Error is three.Error, type(three).__name__)"),
    ) == "LazyModule True module"  # fmt: skip


def test_loaded_module_is_kept() -> None:
    assert run("import wave", 'import_lazily("wave")', "print(type(sys.modules['wave']).__name__)") == "module"


def test_submodule_can_be_imported_first() -> None:
    assert run('import_lazily("xml")', "import xml.dom", "print(xml.dom.Node.ELEMENT_NODE)") == "1"


def test_missing_attribute_raises_attribute_error() -> None:
    assert run('import_lazily("wave")', "import wave", "print(hasattr(wave, 'nothing'))") == "False"
