"""Files that people write: YAML or JSON, read as a struct, with errors that name the place."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import yaml
from msgspec import Struct

from rce import errors
from rce.errors import InvalidRequest

S = TypeVar("S", bound=Struct)


class _Loader(yaml.SafeLoader):
    """Keys are strings, as in JSON: YAML takes the key `on` for true."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and key.tag != "tag:yaml.org,2002:merge":
                key.tag = "tag:yaml.org,2002:str"
        return super().construct_mapping(node, deep)


def read(path: Path, kind: type[S]) -> S:
    """The content of a file: YAML if its name ends in `.yaml` or `.yml`, else JSON. InvalidRequest."""
    try:
        text = path.read_text(encoding="utf-8")
        content: Any = yaml.load(text, _Loader) if path.suffix in (".yaml", ".yml") else json.loads(text)
    except OSError as error:
        raise InvalidRequest(errors.reason(error)) from None
    except json.JSONDecodeError as error:
        raise InvalidRequest(f"{path}: no JSON (name it .yaml if it is YAML): {error}") from None
    except (ValueError, RecursionError, yaml.YAMLError) as error:
        raise InvalidRequest(f"{path}: {error}") from None
    try:
        return msgspec.convert(content, kind, dec_hook=path_hook)
    except msgspec.ValidationError as error:
        reason, _, place = str(error).partition(" - at `$")
        place = place.rstrip("`").lstrip(".")
        raise InvalidRequest(f"{path}: {place + ': ' if place else ''}{reason}", field=place) from None


def path_hook(kind: type[Any], value: object) -> Path:
    """How msgspec makes paths, which it does not know, of strings; `~` is the user's home."""
    if kind is Path and isinstance(value, str | Path):
        return Path(value).expanduser()
    raise NotImplementedError(f"fields of type {kind} are not supported")
