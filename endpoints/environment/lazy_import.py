"""Lazy import of a module, which is loaded when one of its attributes is first used.

All message modules that ROS generates import numpy. An endpoint passes serialized messages through and never needs it:
it would be a quarter of the endpoint's start time and memory.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import Any


class LazyModule(ModuleType):
    """Placeholder in `sys.modules` for a module that is not loaded yet.

    `importlib.util.LazyLoader` is no alternative: it loads the module at the second `import`.
    """

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") and name != "__path__":
            raise AttributeError(f"module {self.__name__} is not loaded yet and has no {name}")
        if sys.modules.get(self.__name__) is self:
            del sys.modules[self.__name__]
        return getattr(import_module(self.__name__), name)


def import_lazily(name: str) -> None:
    """Postpone the import of a module, unless it is loaded already, until one of its attributes is used."""
    if name not in sys.modules:
        sys.modules[name] = LazyModule(name)
