"""YAML and JSON files decoded as structs, with errors that name the file and the field."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import yaml
from msgspec import Struct

from rce.choices import with_choices
from rce.errors import InvalidRequest, describe_os_error
from rce.protocol.known_keys import unknown_keys
from rce.spelling import did_you_mean

S = TypeVar("S", bound=Struct)


class _Loader(yaml.SafeLoader):
    """YAML loader whose mapping keys are strings, as in JSON: plain YAML reads the key `on` as true."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and key.tag != "tag:yaml.org,2002:merge":
                key.tag = "tag:yaml.org,2002:str"
        return super().construct_mapping(node, deep)


def read(path: Path, kind: type[S]) -> S:
    """Decode a file as a `kind`: YAML if its name ends in `.yaml` or `.yml`, else JSON.

    Raises:
        InvalidRequest: The file cannot be read, is malformed, or does not match the struct.
    """
    return decode(path, load(path), kind)


def load(path: Path) -> Any:
    """Return the content of a file; raise InvalidRequest if it cannot be read or is malformed."""
    try:
        text = path.read_text(encoding="utf-8")
        return yaml.load(text, _Loader) if path.suffix in (".yaml", ".yml") else json.loads(text)
    except OSError as error:
        raise InvalidRequest(describe_os_error(error)) from None
    except json.JSONDecodeError as error:
        raise InvalidRequest(f"{path} is not JSON (a YAML file must be named .yaml): {error}") from None
    except (ValueError, RecursionError, yaml.YAMLError) as error:
        raise InvalidRequest(f"{path}: {error}") from None


def decode(path: Path, content: Any, kind: type[S]) -> S:
    """Decode the content of a file as a `kind`; raise InvalidRequest, with the file and the place, if it is none."""
    try:
        return msgspec.convert(content, kind, dec_hook=path_hook)
    except msgspec.ValidationError as error:
        reason, place = with_choices(error, kind)
        if "required field" in reason or "unknown field" in reason:
            reason += _hint(content, kind)
        raise InvalidRequest(f"{path}: {place + ': ' if place else ''}{reason}", field=place) from None


def _hint(content: Any, kind: type[Struct]) -> str:
    """Return the nearest known key to the first unknown one, in parentheses; empty if none is near."""
    unknown = unknown_keys(kind, msgspec.json.encode(content))
    hints = (f" ({path}: {hint})" for path, key, known in unknown if (hint := did_you_mean(key, known)))
    return next(hints, "")


def path_hook(kind: type[Any], value: object) -> Path:
    """Decode a `Path`, which msgspec does not know, from a string; `~` is the user's home directory."""
    if kind is Path:
        if not isinstance(value, str | Path):
            raise TypeError(f"Expected `str`, got `{type(value).__name__}`")  # becomes a ValidationError
        return Path(value).expanduser()
    raise NotImplementedError(f"fields of type {kind} are not supported")
