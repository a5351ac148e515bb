"""Message types that need not be installed."""

from __future__ import annotations

import importlib
import sys

import pytest

pytest.importorskip("rclpy", reason="needs the extra `ros`")

PACKAGES = ("tf2_msgs", "map_msgs", "nav2_msgs", "slam_toolbox")
NAMES = ("TFMessage", "OccupancyGridUpdate", "nav2", "slam_toolbox")


def test_installed_types_are_found(interfaces: None) -> None:
    from rce_mapping import optional

    assert all(getattr(optional, name) for name in NAMES)
    assert optional.slam_toolbox.Reset.Request().pause_new_measurements is False


@pytest.mark.parametrize("package", PACKAGES)
def test_missing_package_switches_only_its_features_off(
    interfaces: None, monkeypatch: pytest.MonkeyPatch, package: str
) -> None:
    for module in (package, f"{package}.msg", f"{package}.srv"):
        monkeypatch.setitem(sys.modules, module, None)  # its import fails
    monkeypatch.delitem(sys.modules, "rce_mapping.optional", raising=False)
    optional = importlib.import_module("rce_mapping.optional")
    off = NAMES[PACKAGES.index(package)]
    assert [name for name in NAMES if getattr(optional, name) is None] == [off]
