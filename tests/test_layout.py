"""Tests mirror the tree: each module has a test file of its name."""

from __future__ import annotations

from pathlib import Path

from tests.support.paths import ROOT

PACKAGES = ("rce", "master", "endpoints", "containers", "converters", "provisioning")
PROGRAMS = {"__init__.py", "__main__.py"}  # tested by their packages and by running them
WITHOUT_LOGIC = {
    "containers/docker/setup.py": "a record; every test of the engine finds its containers by it",
    "containers/kubernetes/setup.py": "two records",
    "containers/nodes/rce_bench/images.py": "subscribes to a topic, without a reaction",
    "converters/dialect.py": "a type alias",
    "endpoints/gateways/rosbridge/peer.py": "a protocol",
    "master/graph/effects.py": "structs and type aliases",
    "master/storage/migrations/env.py": "started by Alembic in each test of migrations",
    "rce/api/views/catalogue.py": "structs",
    "rce/api/views/logs.py": "one struct",
    "rce/api/views/pages.py": "one struct",
    "rce/api/views/resources.py": "structs",
    "rce/api/views/traces.py": "structs",
    "rce/api/knowledge_requests.py": "structs",
    "rce/cli/commands/knowledge.py": "declarations; test_table.py checks the commands of all modules",
    "rce/cli/commands/maps3d.py": "declarations; test_table.py checks the commands of all modules",
    "rce/cli/commands/planning.py": "declarations; test_table.py checks the commands of all modules",
    "rce/cli/commands/packages.py": "declarations; test_table.py checks the commands of all modules",
    "rce/client/events.py": "type aliases and two tuples",
    "rce/codecs/packed.py": "structs",
    "rce/control/calls/agents.py": "structs; test_call.py checks the calls of all modules",
    "rce/control/calls/environments.py": "structs",
    "rce/control/calls/joining.py": "structs",
    "rce/control/calls/knowledge.py": "structs",
    "rce/control/calls/recordings.py": "structs",
    "rce/control/calls/services.py": "structs",
    "rce/control/calls/watching.py": "structs",
    "rce/mapping/mapper.py": "a protocol and its results",
    "rce/mapping3d/dense/mesh.py": "two records",
    "rce/mapping3d/dense/tracking_kernels.py": "kernels in a language of their own; test_tracking.py runs all of them",
    "rce/protocol/slots.py": "constants",
    "rce/video/packet.py": "a record",
}
"""Modules that need no tests, with the reason."""


def modules() -> list[Path]:
    """Return all modules that need a test file, relative to the project."""
    found = (path.relative_to(ROOT) for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
    return [each for each in found if each.name not in PROGRAMS and each.parent.name != "versions"]


def mirrored(module: Path) -> Path:
    """Return the test file of a module."""
    return Path("tests") / module.parent / f"test_{module.name.lstrip('_')}"


def test_each_module_has_a_test_file_of_its_name() -> None:
    missing = {str(each) for each in modules() if not (ROOT / mirrored(each)).exists()}
    assert missing == set(WITHOUT_LOGIC)
