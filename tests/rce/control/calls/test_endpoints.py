"""Keys of parameters."""

from __future__ import annotations

from rce.control.calls.endpoints import ParameterSpec


def test_parameters_of_different_nodes_have_different_keys() -> None:
    specs = [ParameterSpec("rate", 1), ParameterSpec("rate", 1, "echo"), ParameterSpec("depth", 1, "echo")]
    assert [spec.key for spec in specs] == [":rate", "echo:rate", "echo:depth"]
    assert ParameterSpec("rate", 2).key == specs[0].key, "a new value replaces the old one"
