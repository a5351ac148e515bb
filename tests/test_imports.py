"""Imports go one way, and a robot's installation needs no more than the base dependencies."""

from __future__ import annotations

import ast
import functools
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.paths import ROOT

MAY_IMPORT: dict[str, set[str]] = {
    "rce": set(),
    "master": {"rce"},
    "containers": {"rce"},
    "converters": {"rce"},
    "provisioning": {"rce"},
    "endpoints": {"rce", "converters"},
}
ONLY_IN: dict[str, tuple[str, ...]] = {
    "docker": ("containers/docker/", "containers/swarm/", "provisioning/image.py", "provisioning/user_image.py"),
    "kubernetes_asyncio": ("containers/kubernetes/",),
    "picows": ("rce/client/websocket.py",),
    "rclpy": ("endpoints/environment/", "containers/nodes/"),
    "cv2": (
        "converters/",
        "endpoints/robot/worker.py",
        "rce/mapping/",
        "rce/mapping3d/",
        "rce/planning/",
        "rce/recognition/",
    ),
}
BASE = {"rce", "msgspec", "picows", "python_socks", "websockets", "yaml"} | set(sys.stdlib_module_names)
# Modules of `rce` that need an extra, and what they may import for it. Modules of the base must not import them.
WITH_EXTRA: dict[str, set[str]] = {
    "rce/bag/": {"mcap"},
    "rce/net/certificates.py": {"cryptography"},
    "rce/control/base_broker.py": {"twisted"},
    "rce/control/broker.py": {"twisted"},
    "rce/control/client.py": {"twisted"},
    "rce/control/connection.py": {"twisted"},
    "rce/control/credential.py": {"twisted"},
    "rce/control/decoder.py": {"twisted"},
    "rce/control/messages.py": {"twisted"},
    "rce/control/removed_users.py": {"twisted"},
    "rce/control/server.py": {"twisted"},
    "rce/control/tls.py": {"twisted", "cryptography", "OpenSSL"},
    "rce/process/exposition.py": {"prometheus_client"},
    "rce/process/loop.py": {"twisted", "uvloop"},
    "rce/process/logs.py": {"twisted"},
    "rce/process/reactor.py": {"twisted", "uvloop"},
    # `job_program` maps in a process of its own; the service itself must not have these libraries in its memory.
    "rce/mapservice/": {"aiohttp", "lxml", "twisted"},
    "rce/services/": {"aiohttp", "twisted"},
    "rce/knowledge/": {"aiohttp", "twisted", "rdflib", "pyoxigraph", "pyparsing"},
    "rce/web/": {"aiohttp"},
    "rce/mapping/": {"numpy", "numba", "scipy", "cv2", "rosbags"},
    "rce/mapping3d/": {"numpy", "numba", "scipy", "cv2", "rosbags", "gtsam", "kiss_icp", "warp"},
    "rce/planning/": {"numpy", "numba", "scipy", "cv2"},
    "rce/recognition/": {"numpy", "cv2"},
    "rce/video/": {"av", "numpy"},
    "rce/cli/interactive.py": {"prompt_toolkit"},
    "rce/bench": {
        *("av", "numpy", "matplotlib", "twisted", "autobahn", "rosbags", "uvloop", "txaio", "playwright", "psutil"),
        "sqlalchemy",
    },
    "rce/cli/lazy/bag.py": {"mcap"},
    "rce/cli/lazy/bench.py": {"numpy"},
    "rce/cli/lazy/localise.py": {"numpy"},
    "rce/cli/lazy/map.py": {"numpy"},
    "rce/cli/lazy/map3d.py": {"numpy"},
    "rce/cli/lazy/plan.py": {"numpy"},
    "rce/cli/lazy/bench_map3d.py": {"numpy"},
    "rce/client/images.py": {"numpy", "PIL"},
    "rce/codecs/clouds.py": {"numpy"},
    "rce/codecs/images.py": {"numpy"},
}
# Packages inside `rce` that must stay below the others: what they may import of `rce`, beside themselves.
LAYERS: dict[str, set[str]] = {
    "rce/protocol/": {"rce.choices", "rce.errors", "rce.schemas", "rce.spelling"},
    "rce/net/": {"rce.errors"},
    "rce/client/": {
        "rce.errors",
        "rce.protocol",
        "rce.net",
        "rce.api",
        "rce.schemas",
        "rce.spelling",
        "rce.structfile",
        "rce.codecs",
        "rce.video",
    },
    "rce/codecs/": {"rce.errors", "rce.protocol", "rce.video"},
    "rce/video/": {"rce.errors"},
    "rce/web/": {"rce.errors", "rce.net", "rce.api", "rce.process", "rce.schemas"},
    "rce/services/": {
        "rce.choices",
        "rce.errors",
        "rce.control",
        "rce.net",
        "rce.process",
        "rce.value_count",
        "rce.web",
    },
    "rce/api/": {"rce.errors", "rce.protocol", "rce.control.calls", "rce.net.loopback"},
}
PURE = "master/graph/"
IMPURE = {"asyncio", "twisted", "sqlalchemy", "aiohttp", "socket", "threading", "subprocess"}
FILES = sorted(path for folder in MAY_IMPORT for path in (ROOT / folder).rglob("*.py"))


def relative(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@functools.cache
def imported(path: Path) -> tuple[tuple[str, bool], ...]:
    """Return the modules that a file imports, and for each whether importing the file imports it."""
    return tuple(_imports(ast.parse(path.read_text(), str(path)), path, True))


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
def test_light_installation_can_import_its_modules(path: Path) -> None:
    at_once = {name for name, at_once in imported(path) if at_once}
    allowed = BASE | (extra_of(relative(path)) or set())
    assert {name.split(".")[0] for name in at_once} <= allowed
    if is_needed_by_robots(path):
        for name in at_once:
            assert extra_of(name.replace(".", "/") + ".py") is None, f"{relative(path)} imports {name}"


@pytest.mark.parametrize("layer", LAYERS)
def test_lower_packages_import_no_higher_ones(layer: str) -> None:
    own = layer.rstrip("/").replace("/", ".")
    allowed = {own, *LAYERS[layer]}
    for path in FILES:
        if relative(path).startswith(layer):
            for name in {name for name, at_once in imported(path) if at_once and name.startswith("rce.")}:
                assert any(name == each or name.startswith(f"{each}.") for each in allowed), f"{relative(path)}: {name}"


def test_command_graph_is_pure() -> None:
    """It neither waits nor does I/O: nothing that it imports, at whatever distance, may bring what does."""
    seen: dict[str, str] = {}
    waiting = [(relative(path), "") for path in FILES if relative(path).startswith(PURE)]
    while waiting:
        file, chain = waiting.pop()
        if file in seen:
            continue
        seen[file] = f"{chain} > {file}" if chain else file
        for name in {name for name, at_once in imported(ROOT / file) if at_once}:
            assert name.split(".")[0] not in IMPURE, f"{name} by {seen[file]}"
            waiting += [(each, seen[file]) for each in own_files(name)]
    assert len(seen) > 20


def own_files(name: str) -> list[str]:
    """Return the files that importing a module of ours runs: those of its packages, and its own."""
    parts = name.split(".")
    stems = ["/".join(parts[: length + 1]) for length in range(len(parts))]
    found = [f"{stem}{end}" for stem in stems for end in ("/__init__.py", ".py")]
    return [file for file in found if parts[0] in MAY_IMPORT and (ROOT / file).is_file()]


def test_provisioning_starts_on_the_standard_library() -> None:
    """The script and its imports run before anything is installed."""
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


def test_files_were_found_and_read() -> None:
    assert {relative(path).split("/")[0] for path in FILES} == set(MAY_IMPORT)
    seen = {name for path in FILES for name, _ in imported(path)}
    assert {"rce.errors", "twisted.logger", "msgspec"} <= seen


def test_no_test_module_imports_another() -> None:
    """Tests share what stands in `tests/support`."""
    for path in sorted((ROOT / "tests").rglob("*.py")):
        for name in {name for name, _ in imported(path) if name.startswith("tests.")}:
            assert not any(part.startswith("test_") for part in name.split(".")), f"{name} in {relative(path)}"
