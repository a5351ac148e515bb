"""Converters of users: found in files and packages, and refused with file, line and remedy."""

from __future__ import annotations

import json
import re
import sys
from importlib import metadata
from pathlib import Path

import pytest

from converters import Converter, TypeRegistry, Wire, custom_files
from converters.custom import CustomCodec
from converters.custom_files import Description, describe, load, wanted
from rce.errors import StartFailed
from rce.protocol.names import parse_type
from tests.support.paths import ROOT

ID = "0a" * 16
GOOD = """
from converters import Converter

class Short(Converter):
    name = "short"
    type = "std_msgs/String"

    def from_robot(self, value):
        return {"data": value}

    def to_robot(self, message):
        return message["data"]
"""


def write(folder: Path, text: str, name: str = "mine.py") -> str:
    file = folder / name
    file.write_text(text)
    return str(file)


def refusal(path: str) -> str:
    with pytest.raises(StartFailed) as caught:
        load(path)
    return str(caught.value)


def test_converter_of_a_file_is_found(tmp_path: Path) -> None:
    found = load(write(tmp_path, GOOD))
    assert describe(found) == [Description("short", "std_msgs/msg/String", default=False)]
    codec = CustomCodec(TypeRegistry().message(parse_type("std_msgs/String")), found["short"])
    assert codec.decode(codec.encode(Wire(False, b'"hi"', {}))).raw == b'"hi"'


def test_all_files_of_a_directory_are_loaded_and_helpers_among_them_need_no_converter(tmp_path: Path) -> None:
    write(tmp_path, GOOD)
    write(tmp_path, GOOD.replace('"short"', '"other"'), "other.py")
    write(tmp_path, "FACTOR = 2\n", "helper.py")
    assert sorted(load(str(tmp_path))) == ["other", "short"]


def test_base_class_that_a_file_imports_is_not_a_converter_of_its_own(tmp_path: Path) -> None:
    text = GOOD.replace("import Converter\n", "import Converter\nfrom converters.custom import Converter as Base\n")
    assert list(load(write(tmp_path, text))) == ["short"]


def test_without_a_path_and_packages_there_are_none() -> None:
    assert not wanted("")
    assert wanted("x.py")
    assert load("") == {}


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("def f(:\n", "mine.py, line 1: SyntaxError: invalid syntax: correct it"),
        (
            "import math\n\nmath.nothing()\n",
            "mine.py, line 3: AttributeError: .*attribute 'nothing': correct it",
        ),
        ("import json\n\njson.loads('x')\n", "mine.py, line 3: JSONDecodeError: .*: correct it"),
        ("import no_such_package_here\n", "mine.py, line 1: ModuleNotFoundError: .*no_such_package_here"),
        ("x = 1\n", "mine.py: it has no subclass of converters.Converter: add one, or correct --converters"),
        (GOOD.replace('name = "short"', ""), "mine.py, class Short: it needs a `name`"),
        (GOOD.replace('"short"', '"Short Form"'), "it needs a `name`.*lower-case letters"),
        (GOOD.replace('"short"', '"ros1"'), "'ros1' is the name of a format of the platform: choose another"),
        (GOOD.replace('"std_msgs/String"', '"String"'), "it needs the `type`.*'sensor_msgs/PointCloud2'"),
        (GOOD.replace("def to_robot", "def to_robots"), "class Short: it lacks to_robot"),
        (GOOD + "\n    def __init__(self):\n        self.x = 1 / 0\n", "mine.py, line 15: ZeroDivisionError"),
        (GOOD + GOOD.replace("class Short", "class Long"), "class Long: the name 'short' is that of .*class Short"),
    ],
)
def test_broken_file_is_refused_with_place_and_remedy(tmp_path: Path, text: str, reason: str) -> None:
    message = refusal(write(tmp_path, text))
    assert re.search(reason, message), message
    assert message.startswith(f"converters: {tmp_path}/mine.py")


def test_error_within_a_library_names_the_line_of_the_file_that_is_loaded_last(tmp_path: Path) -> None:
    assert "line 2: ValueError" in refusal(write(tmp_path, "import json\nint('x')\n"))


def test_two_defaults_of_one_type_are_refused(tmp_path: Path) -> None:
    write(tmp_path, GOOD + "    default = True\n", "a.py")
    write(tmp_path, GOOD.replace('"short"', '"long"') + "    default = True\n", "b.py")
    assert "b.py, class Short: std_msgs/String has a default converter in" in refusal(str(tmp_path))


def test_path_that_is_not_there_is_refused(tmp_path: Path) -> None:
    assert "there is no such file or directory: correct --converters" in refusal(str(tmp_path / "no.py"))
    assert "the directory has no Python file" in refusal(str(tmp_path))
    assert "not a Python file" in refusal(write(tmp_path, "", "notes.txt"))


def install(folder: Path, monkeypatch: pytest.MonkeyPatch, value: str) -> None:
    """Install a package that has a converter by its entry points."""
    write(folder, GOOD, "short_package.py")
    info = folder / "short_package-1.0.dist-info"
    info.mkdir()
    write(info, "Metadata-Version: 2.1\nName: short-package\nVersion: 1.0\n", "METADATA")
    write(info, f"[{custom_files.GROUP}]\nshort = {value}\n", "entry_points.txt")
    monkeypatch.syspath_prepend(folder)
    monkeypatch.delitem(sys.modules, "short_package", raising=False)


def test_converter_of_an_installed_package_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, monkeypatch, "short_package:Short")
    assert [point.name for point in metadata.entry_points(group=custom_files.GROUP)] == ["short"]
    assert wanted("")
    assert list(load("")) == ["short"]


@pytest.mark.parametrize(
    ("value", "reason"),
    [
        ("short_package:Nothing", "package short-package, short_package:Nothing: AttributeError"),
        ("no_such_package_here:X", "package short-package, .*ModuleNotFoundError"),
        ("short_package:__doc__", "must be a subclass of converters.Converter"),
    ],
)
def test_broken_package_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, value: str, reason: str) -> None:
    install(tmp_path, monkeypatch, value)
    assert re.search(reason, refusal("")), refusal("")


def test_example_of_the_guide_works(tmp_path: Path) -> None:
    guide = (ROOT / "docs/guides/use-own-converters.md").read_text("utf-8")
    (example,) = (code for code in re.findall(r"```python\n(.*?)```", guide, re.DOTALL) if "(Converter)" in code)
    converter: Converter = load(write(tmp_path, example, "packed_scan.py"))["packed-scan"]
    plain = TypeRegistry().message(parse_type("sensor_msgs/LaserScan"))
    codec = CustomCodec(plain, converter)
    beams = b"".join(number.to_bytes(2, "little") for number in (1500, 65000, 20))
    cdr = codec.encode(Wire(True, f'"{ID}"'.encode(), {ID: beams}))
    assert json.loads(bytes(plain.decode(cdr).raw))["ranges"] == pytest.approx([1.5, 65, 0.02])
    assert list(codec.decode(cdr).blobs.values()) == [beams]
