"""On the PYTHONPATH of users' nodes: hides RCE's own packages, whose names may be those of the users' modules."""

import sys
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path

OURS = frozenset({"rce", "master", "endpoints", "containers", "converters", "provisioning", "tests"})
ROOT = Path(__file__).parents[3]


class Hider(MetaPathFinder):
    """Finds modules with the names of ours, but not ours."""

    def find_spec(self, name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        if path is not None or name not in OURS:
            return None
        spec = PathFinder.find_spec(name, [entry for entry in sys.path if Path(entry or ".").resolve() != ROOT])
        if spec is None:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return spec


sys.meta_path.insert(0, Hider())
