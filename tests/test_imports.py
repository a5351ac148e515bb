"""Imports go one way, and a robot's installation needs no more than the base dependencies."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
MAY_IMPORT: dict[str, set[str]] = {
    "rce": set(),
    "master": {"rce"},
    "containers": {"rce"},
    "converters": {"rce"},
    "provisioning": {"rce"},
    "endpoints": {"rce", "converters"},
}
ONLY_IN: dict[str, tuple[str, ...]] = {
    "docker": ("containers/docker", "containers/swarm", "provisioning/image.py", "provisioning/user_image.py"),
    "rclpy": ("endpoints/environment/", "containers/nodes/"),
    "cv2": ("converters/", "rce/mapping/"),
}
BASE = {"rce", "msgspec", "websockets", "yaml"} | set(sys.stdlib_module_names)
# Parts of `rce` for installations with an extra: what they may import besides, and nothing of the base may import them.
WITH_EXTRA: dict[str, set[str]] = {
    "rce/certificates.py": {"cryptography"},
    "rce/broker.py": {"twisted"},
    "rce/control.py": {"twisted"},
    "rce/credential.py": {"twisted"},
    "rce/exposition.py": {"prometheus_client"},
    "rce/loop.py": {"twisted", "uvloop"},
    "rce/logs.py": {"twisted"},
    "rce/reactor.py": {"twisted", "uvloop"},
    # `work` maps, in a process of its own; the service itself has none of that in its memory.
    "rce/mapservice/": {"aiohttp", "lxml", "twisted"},
    "rce/control_tls.py": {"twisted"},
    "rce/mapping/": {"numpy", "numba", "scipy", "cv2", "rosbags"},
    "rce/console/interactive.py": {"prompt_toolkit"},
    "rce/bench": {
        *("numpy", "matplotlib", "twisted", "autobahn", "rosbags", "uvloop", "txaio", "playwright", "psutil"),
    },
    "rce/commands/bench.py": {"numpy"},
    "rce/commands/map.py": {"numpy"},
    "rce/client/images.py": {"numpy", "PIL"},
}
FILES = sorted(path for folder in MAY_IMPORT for path in (ROOT / folder).rglob("*.py"))


def relative(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def imported(path: Path) -> Iterator[tuple[str, bool]]:
    """Full names of the modules that a file imports, and whether it does so when it is itself imported."""
    yield from _imports(ast.parse(path.read_text(), str(path)), path, True)


def _imports(node: ast.AST, path: Path, at_once: bool) -> Iterator[tuple[str, bool]]:
    if isinstance(node, ast.Import):
        yield from ((alias.name, at_once) for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        package = relative(path).removesuffix(".py").split("/")[: -node.level] if node.level else []
        module = ".".join([*package, *([node.module] if node.module else [])])
        yield module, at_once
        yield from ((f"{module}.{alias.name}", at_once) for alias in node.names)
    elif isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
        for child in node.body:
            yield from _imports(child, path, False)
        for child in node.orelse:
            yield from _imports(child, path, at_once)
    else:
        inside = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
        for child in ast.iter_child_nodes(node):
            yield from _imports(child, path, at_once and not inside)


def extra_of(file: str) -> set[str] | None:
    return next((extra for part, extra in WITH_EXTRA.items() if file.startswith(part)), None)


def is_needed_by_robots(path: Path) -> bool:
    return relative(path).startswith("rce/") and extra_of(relative(path)) is None


@pytest.mark.parametrize("path", FILES, ids=relative)
def test_imports_go_one_way(path: Path) -> None:
    own = relative(path).split("/")[0]
    ours = {name.split(".")[0] for name, _ in imported(path)} & {*MAY_IMPORT, "tests"}
    assert ours <= MAY_IMPORT[own] | {own}


@pytest.mark.parametrize("path", FILES, ids=relative)
def test_heavy_libraries_are_imported_in_their_place_only(path: Path) -> None:
    for name in {name.split(".")[0] for name, _ in imported(path)} & set(ONLY_IN):
        assert relative(path).startswith(ONLY_IN[name]), f"{name} in {relative(path)}"


@pytest.mark.parametrize("path", [path for path in FILES if relative(path).startswith("rce/")], ids=relative)
def test_a_light_installation_can_import_what_it_needs(path: Path) -> None:
    at_once = {name for name, at_once in imported(path) if at_once}
    allowed = BASE | (extra_of(relative(path)) or set())
    assert {name.split(".")[0] for name in at_once} <= allowed
    if is_needed_by_robots(path):
        for name in at_once:
            assert extra_of(name.replace(".", "/") + ".py") is None, f"{relative(path)} imports {name}"


def test_provisioning_starts_on_the_standard_library() -> None:
    """The script and what it imports run before anything is installed."""
    seen: set[Path] = set()
    waiting = [ROOT / "provisioning" / "provision"]
    while waiting:
        path = waiting.pop()
        seen.add(path)
        for name in {name for name, at_once in imported(path) if at_once}:
            own = ROOT / (name.replace(".", "/") + ".py")
            if name.startswith("provisioning.") and own.exists():
                waiting += [own] if own not in seen else []
            else:
                assert name.split(".")[0] in {*sys.stdlib_module_names, "provisioning"}, f"{name} in {relative(path)}"
    assert len(seen) > 2


def test_the_files_were_found_and_read() -> None:
    assert {relative(path).split("/")[0] for path in FILES} == set(MAY_IMPORT)
    seen = {name for path in FILES for name, _ in imported(path)}
    assert {"rce.errors", "twisted.logger", "msgspec"} <= seen


def test_names_of_test_modules_are_unique() -> None:
    """Folders of tests are no packages: pytest refuses two modules of one name, and then no test runs at all."""
    names = [path.name for path in (ROOT / "tests").rglob("test_*.py")]
    assert sorted(names) == sorted(set(names))
