"""Module on the PYTHONPATH of users' nodes that hides RCE's packages: users may have modules of the same names."""

import sys
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path

OURS = frozenset({"rce", "master", "endpoints", "containers", "converters", "provisioning", "tests"})
ROOT = Path(__file__).parents[3]


class Hider(MetaPathFinder):
    """Finder for the names of RCE's packages that skips the directory of RCE."""

    def find_spec(self, name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        """Find a top-level module with the name of one of RCE's packages elsewhere on the path."""
        if path is not None or name not in OURS:
            return None
        spec = PathFinder.find_spec(name, [entry for entry in sys.path if Path(entry or ".").resolve() != ROOT])
        if spec is None:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return spec


sys.meta_path.insert(0, Hider())
