"""A module that is loaded when something in it is asked for.

All message modules that ROS generates import numpy, and an endpoint, which passes serialized messages on, never needs
it: it would be a quarter of its start and of its memory.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import Any


class Later(ModuleType):
    """Stands in `sys.modules` until then. (importlib's LazyLoader loads at the second `import`.)"""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") and name != "__path__":
            raise AttributeError(f"module {self.__name__} is not loaded yet and has no {name}")
        if sys.modules.get(self.__name__) is self:
            del sys.modules[self.__name__]
        return getattr(import_module(self.__name__), name)


def load_later(name: str) -> None:
    """From now on `import name` is free, and what is first used of it costs the import."""
    if name not in sys.modules:
        sys.modules[name] = Later(name)
