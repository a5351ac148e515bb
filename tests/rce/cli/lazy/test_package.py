"""`rce package`."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest

from rce.cli.execute import FAILURE, SUCCESS, run
from rce.cli.lazy import package
from rce.errors import StartFailed
from rce.packages.archive import Contents, Entry
from rce.packages.client import Package, Version
from tests.support.console import login, open_terminal, rce
from tests.support.master.served import Served

PACKAGE_XML = """\
<?xml version="1.0"?>
<package format="3">
  <name>nav</name>
  <version>0.1.0</version>
  <description>Navigation.</description>
  <maintainer email="ann@example.org">Ann</maintainer>
  <license>MIT</license>
  <export><build_type>ament_python</build_type></export>
</package>
"""


async def test_package_uses_the_current_context_unless_given_an_address(
    served: Served, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    await login(served.url, "ann", "home")
    monkeypatch.delenv("RCE_PASSWORD")
    assert await rce("package", "list", "--json") == SUCCESS
    assert capsys.readouterr().out.splitlines()[-1] == "[]"
    for option in (("--url", served.url), ("--context", "home")):
        assert await rce("package", "list", *option) == SUCCESS
    assert await rce("package", "list", "--url", served.url, "--user", "bob") == FAILURE


class FakePackages:
    """Packages of a platform; records the calls."""

    def __init__(self) -> None:
        self.calls: list[tuple[object, ...]] = []
        self.packages: list[Package] = []

    def list(self) -> list[Package]:
        return self.packages

    def push(self, name: str, entries: Sequence[Entry]) -> Contents:
        self.calls.append(("push", name, sorted(entry.path for entry in entries)))
        return Contents("0123456789abcdef", 1_250_000, len(entries), [name], installed=False)

    def share(self, name: str, users: Sequence[str]) -> None:
        self.calls.append(("share", name, users))

    def unshare(self, name: str, users: Sequence[str]) -> None:
        self.calls.append(("unshare", name, users))

    def remove(self, name: str, version: str = "") -> None:
        self.calls.append(("remove", name, version))


@pytest.fixture
def packages(monkeypatch: pytest.MonkeyPatch) -> FakePackages:
    """Packages of the user ann."""
    found = FakePackages()
    monkeypatch.setattr(package, "_connect", lambda args: (found, "ann"))
    return found


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """ROS package `nav` in Python."""
    directory = tmp_path / "nav"
    (directory / "nav").mkdir(parents=True)
    (directory / "package.xml").write_text(PACKAGE_XML)
    (directory / "nav" / "drive.py").write_text("print('go')\n")
    return directory


@pytest.mark.parametrize(("options", "name"), [([], "nav"), (["--name", "fleet"], "fleet")])
def test_directory_is_pushed_under_its_own_or_a_given_name(
    options: list[str], name: str, source: Path, packages: FakePackages, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["package", "push", str(source), *options]) == SUCCESS
    assert packages.calls == [("push", name, ["nav/nav/drive.py", "nav/package.xml"])]
    assert capsys.readouterr().out == f"ann/{name}@0123456789ab: {name}; 2 files, 1.2 MB\n"


def test_pushed_package_is_shared(source: Path, packages: FakePackages) -> None:
    assert run(["package", "push", str(source), "--share", "ada", "--share", "all"]) == SUCCESS
    assert packages.calls[1:] == [("share", "nav", ["ada", "*"])]


@pytest.mark.parametrize(
    ("line", "call"),
    [
        ("share nav ada all", ("share", "nav", ["ada", "*"])),
        ("unshare nav", ("unshare", "nav", [])),
        ("remove nav", ("remove", "nav", "")),
        ("remove nav@0123", ("remove", "nav", "0123")),
    ],
)
def test_change_is_sent(line: str, call: tuple[object, ...], packages: FakePackages) -> None:
    assert run(["package", *line.split()]) == SUCCESS
    assert packages.calls == [call]


def test_packages_are_listed_with_their_newest_version_first(
    packages: FakePackages, capsys: pytest.CaptureFixture[str]
) -> None:
    versions = [Version("1" * 64, 1_000_000, ["nav"], 1e9), Version("2" * 64, 2_500_000, ["nav", "nav_msgs"], 2e9)]
    packages.packages = [Package("ann/nav", versions, ["ada", "bob"]), Package("eve/arm", [], ["*"])]
    assert run(["package", "list"]) == SUCCESS
    name, newest, oldest, other = capsys.readouterr().out.splitlines()
    assert name == "ann/nav  (shared with ada, bob)"
    assert newest.split()[:1] + newest.split()[3:] == ["2" * 12, "2.5", "MB", "nav,", "nav_msgs"]
    assert oldest.split()[:1] == ["1" * 12]
    assert other == "eve/arm  (shared with everybody)"


def test_long_list_of_ros_packages_is_wrapped_on_a_terminal(
    packages: FakePackages, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = [f"package_{number}" for number in range(6)]
    packages.packages = [Package("ann/nav", [Version("1" * 64, 1_000_000, names, 1e9)], [])]
    terminal = open_terminal(monkeypatch, 80)
    assert run(["package", "list"]) == SUCCESS
    _, *lines = terminal.getvalue().splitlines()
    assert max(map(len, lines)) <= 80
    assert " ".join(line[49:] for line in lines).split(", ") == names


def test_empty_list_says_how_to_push(packages: FakePackages, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["package", "list"]) == SUCCESS
    assert "rce package push DIR" in capsys.readouterr().err


def test_user_without_credentials_is_told_how_to_give_them(
    no_context: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["package", "list", "--user", "eve"]) == FAILURE
    assert "no credentials of user eve" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("errors", "reason"),
    [
        ("t.cpp:3: error: no header\nfailed\n", "t.cpp:3: error: no header\nfailed"),
        ("", "status -9"),
        (" \n", "status -9"),
    ],
)
def test_failed_build_of_type_support_is_explained(
    errors: str, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def build(words: list[str], **options: object) -> subprocess.CompletedProcess[str]:
        assert words[3:5] == [package.TYPE_SUPPORT, "--alone"]
        return subprocess.CompletedProcess(words, -9, "", errors)

    monkeypatch.setattr(subprocess, "run", build)
    interfaces = tmp_path / "nav_msgs"
    interfaces.mkdir()
    (interfaces / "package.xml").write_text(PACKAGE_XML)
    with pytest.raises(StartFailed, match=f"type support for nav_msgs failed: {reason}\n"):
        package.build_type_support([interfaces])


def test_type_support_needs_provisioning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(package, "find_spec", lambda name: None)
    with pytest.raises(StartFailed, match="provisioning"):
        package.build_type_support([tmp_path])
