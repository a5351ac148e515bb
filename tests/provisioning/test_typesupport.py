"""Type support is built, cached and used by real ROS 2 programs."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from provisioning import typesupport as module
from provisioning.definitions import read_packages
from provisioning.typesupport import TypeSupport, build, cache_key, main, shipped
from tests.support.domains import domain
from tests.support.paths import TESTS

MakePackage = Callable[..., Path]
TALK = TESTS / "support" / "ros_talk.py"
LIMIT = 60  # seconds until a ROS 2 program that hangs is killed
PARAMETERS = ("int:=99", "str:=hello", "float:=2.5", "bool:=true", "list:=[1, 2, 3]")


def environment(support: TypeSupport) -> dict[str, str]:
    """Return the environment of a program: PYTHONPATH, and a ROS domain of these tests."""
    own = {"ROS_DOMAIN_ID": str(domain("types")), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    return {**os.environ, **own, "PYTHONPATH": str(support.prefix / "python")}


@contextmanager
def running(support: TypeSupport, *command: str | Path, stop: signal.Signals = signal.SIGTERM) -> Iterator[None]:
    """Run a ROS 2 program, which must exit with status 0 and no output on the signal."""
    pipe = subprocess.PIPE
    program = subprocess.Popen([sys.executable, *command], env=environment(support), stderr=pipe, text=True)
    try:
        yield
        program.send_signal(stop)
        _, errors = program.communicate(timeout=LIMIT)
        assert (program.returncode, errors) == (0, "")
    finally:
        program.kill()
        program.communicate()


def ask(support: TypeSupport, check: str) -> dict[str, object]:
    command = [sys.executable, str(TALK), check]
    done = subprocess.run(command, env=environment(support), stdout=subprocess.PIPE, timeout=LIMIT, check=True)
    answer: dict[str, object] = json.loads(done.stdout)
    return answer


def test_topics(typesupport: TypeSupport) -> None:
    with running(typesupport, TALK, "publish"):
        assert ask(typesupport, "receive") == {"child": "laser", "x": -3, "data": [100, -1]}


def test_string_echo(typesupport: TypeSupport) -> None:
    with running(typesupport, typesupport.prefix / "lib" / "Test" / "stringEcho.py", stop=signal.SIGINT):
        assert ask(typesupport, "stringEcho") == {"data": "grüß dich"}


def test_parameters(typesupport: TypeSupport) -> None:
    node = typesupport.prefix / "lib" / "Test" / "paramTest.py"
    options = [option for parameter in PARAMETERS for option in ("-p", parameter)]
    with running(typesupport, node, "--ros-args", *options):
        text = ask(typesupport, "paramTest")["msg"]
    assert json.loads(str(text)) == {"int": 99, "str": "hello", "float": 2.5, "bool": True, "list": [1, 2, 3]}


def test_converter(typesupport: TypeSupport) -> None:
    with running(typesupport, typesupport.prefix / "lib" / "Test" / "converterTest.py"):
        answer = ask(typesupport, "converterTest")
    pixels = bytes.fromhex(str(answer["img"]))
    assert answer["sum"] == 42
    assert len(pixels) == 3 * 16 * 8
    assert pixels[-3:] == bytes([150, 70, 255])


def test_string_tester(typesupport: TypeSupport) -> None:
    nodes = typesupport.prefix / "lib" / "Test"
    with running(typesupport, nodes / "stringEcho.py"), running(typesupport, nodes / "stringTester.py"):
        times = ask(typesupport, "stringTester")["times"]
    assert isinstance(times, list)
    assert len(times) == 21
    assert min(times) > 0


def test_type_hashes_are_those_of_public_packages(typesupport: TypeSupport) -> None:
    """Compare type hashes with an independent implementation, which has its own copy of tf2_msgs."""
    store = get_typestore(Stores.ROS2_KILTED)
    own = {f"{path.parts[-3]}/msg/{path.stem}": path for path in typesupport.prefix.glob("share/*/msg/*.msg")}
    for name, path in own.items():
        if name not in store.fielddefs:
            store.register(get_types_from_msg(path.read_text(), name))
    for name, path in own.items():
        hashes = json.loads(path.with_suffix(".json").read_text())["type_hashes"]
        assert store.hash_rihs01(name) == next(entry["hash_string"] for entry in hashes if entry["type_name"] == name)
    assert len(own) == 27


def test_key_depends_on_definitions(make_package: MakePackage) -> None:
    root = make_package("own", {"msg/A.msg": "std_msgs/Header header\n"})
    keys = [cache_key(read_packages([root]))]
    (root / "msg" / "A.msg").write_text("std_msgs/Header header\nint32 a\n")
    keys.append(cache_key(read_packages([root])))
    (root / "msg" / "A.msg").rename(root / "msg" / "B.msg")
    keys.append(cache_key(read_packages([root])))
    keys.append(cache_key(read_packages([root, make_package("more", {"msg/A.msg": ""})])))
    assert len(set(keys)) == 4
    assert cache_key(read_packages([root])) == keys[2]


def test_key_depends_on_dependencies(
    make_package: MakePackage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another version of an installed dependency changes the key."""
    for path in ("ament_index", "other_msgs/msg"):
        (tmp_path / "prefix" / "share" / path).mkdir(parents=True)
    used = tmp_path / "prefix" / "share" / "other_msgs" / "msg"
    (used / "B.msg").write_text("int32 b\n")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "prefix"))
    packages = read_packages([make_package("own", {"msg/A.msg": "other_msgs/B b\n"})])
    (used / "B.json").write_text("one")
    before = cache_key(packages)
    (used / "B.json").write_text("two")
    assert cache_key(packages) != before


@pytest.mark.slow
def test_concurrent_builds_build_once(
    compiler: None, make_package: MakePackage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    built: list[Path] = []
    build_packages = module.build_packages

    def count(*arguments: object) -> None:
        built.append(tmp_path)
        build_packages(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(module, "build_packages", count)
    bottom = make_package("beta", {"msg/Same.msg": "int32 b\n", "srv/Same.srv": "Same[] aB\n---\nSame b\n"})
    roots = [make_package("Alpha", {"msg/A.msg": "beta/Same b\n"}), bottom]
    with ThreadPoolExecutor(2) as pool:
        first, second = pool.map(lambda _: build(roots, tmp_path / "cache"), range(2))
    assert first == second
    assert len(built) == 1
    assert sorted(path.name for path in (tmp_path / "cache").iterdir()) == sorted([".lock", first.prefix.name])
    assert sorted(path.name for path in first.prefix.iterdir()) == ["python", "rce-typesupport", "share"]


def test_failed_build_leaves_nothing(
    make_package: MakePackage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("CXX", "no-such-compiler")
    root = make_package("own", {"msg/A.msg": ""})
    assert main([str(root), "--cache", str(tmp_path / "cache")]) == 1
    assert "no-such-compiler" in capsys.readouterr().err
    assert [path.name for path in (tmp_path / "cache").iterdir()] == [".lock"]


def test_command_reports_what_it_leaves_out(
    compiler: None,
    make_package: MakePackage,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(module, "shipped", list)
    root = make_package("own", {"srv/A.srv": "---\n", "msg/B.idl": "", "action/Go.action": "---\n---\nint32 done\n"})
    assert main([str(root), "--cache", str(tmp_path / "cache")]) == 0
    output = capsys.readouterr()
    assert f"left out: {root}/msg/B.idl" in output.err
    prefix = Path(output.out.strip())
    assert (prefix / "python" / "own" / "srv" / "_a.py").exists()
    assert (prefix / "python" / "own" / "action" / "_go.py").exists()
    assert (tmp_path / "cache" / "current").resolve() == prefix


def test_shipped_packages() -> None:
    assert [path.name for path in shipped()] == [
        *("example_interfaces", "ffmpeg_image_transport_msgs", "foxglove_msgs", "map_msgs", "nav2_msgs", "re_msgs"),
        *("re_srvs", "slam_toolbox", "tf2_msgs", "vision_msgs"),
    ]
