"""Context of a launch file."""

from __future__ import annotations

from pathlib import Path

import pytest

from endpoints.environment.launch.interpreter.context import MAX_INCLUDES, MAX_NODES, Context, LaunchError


def test_group_restores_all_settings() -> None:
    context = Context(arguments={"a": "1"})
    with context.group():
        context.launch_configurations["a"] = "2"
        context.environment["A"] = "b"
        context.scope.namespace = "inner"
        context.scope.remappings.append(("a", "b"))
        context.scope.parameters.append({})
    assert context.launch_configurations == {"a": "1"}
    assert "A" not in context.environment
    assert (context.scope.namespace, context.scope.remappings, context.scope.parameters) == ("", [], [])


def test_group_without_scope_changes_what_follows() -> None:
    context = Context()
    with context.group(scoped=False):
        context.launch_configurations["a"] = "2"
    assert context.launch_configurations == {"a": "2"}


def test_group_that_forwards_nothing_begins_empty() -> None:
    context = Context(arguments={"a": "1"})
    with context.group(forwarding=False):
        assert context.launch_configurations == {}
    assert context.launch_configurations == {"a": "1"}


def test_node_gets_only_variables_that_changed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GONE", "1")
    monkeypatch.setenv("KEPT", "1")
    context = Context()
    context.environment["NEW"] = "2"
    del context.environment["GONE"]
    context.add({})
    assert context.nodes[0]["environment"] == {"NEW": "2", "GONE": None}


def test_number_of_nodes_and_includes_is_limited() -> None:
    context = Context()
    for _ in range(MAX_NODES):
        context.add({})
    with pytest.raises(LaunchError, match=f"more than {MAX_NODES} nodes"):
        context.add({})
    context.files = [Path("a.launch.py")] * MAX_INCLUDES
    with pytest.raises(LaunchError, match="does it include itself"), context.within(Path("a.launch.py")):
        pass


def test_restore_without_save_is_an_error() -> None:
    context = Context(arguments={"a": "1"})
    context.save_configurations()
    context.launch_configurations["a"] = "2"
    context.restore_configurations()
    assert context.launch_configurations == {"a": "1"}
    with pytest.raises(LaunchError, match="no launch configurations to restore"):
        context.restore_configurations()
