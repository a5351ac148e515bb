"""Settings of a process: a struct of typed fields, filled from the command line, the environment and a TOML file.

The setting `ws_port` is `--ws-port` on the command line, `RCE_WS_PORT` in the environment and `ws_port = 9010` in the
TOML file given by `--config`, in this order of precedence. Errors name the setting and the source of its value.
"""

from __future__ import annotations

import argparse
import os
import sys
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from rce.errors import InvalidRequest, describe_os_error
from rce.structfile import path_hook

S = TypeVar("S", bound=msgspec.Struct)
PREFIX = "RCE_"


def load(kind: type[S], program: str, arguments: Sequence[str], environment: Mapping[str, str] = os.environ) -> S:
    """Load the settings of a program.

    Args:
        kind: The struct; its docstring and the descriptions of its fields are the help text.
        program: Name of the program, for the help text and errors.
        arguments: Command line without the name of the program.
        environment: Environment variables.

    Raises:
        InvalidRequest: A setting is missing, unknown or wrong; the message names it and its source.
    """
    described = {field.name: _described(field.type) for field in msgspec.structs.fields(kind)}
    parser = argparse.ArgumentParser(prog=program, description=(kind.__doc__ or "").strip(), allow_abbrev=False)
    parser.add_argument("--config", type=Path, metavar="FILE", help="TOML file with any of these settings")
    for field in msgspec.structs.fields(kind):
        option = "--" + field.name.replace("_", "-")
        sort, text = described[field.name]
        text += _default(field)
        if isinstance(sort, msgspec.inspect.BoolType):
            parser.add_argument(
                option, action=argparse.BooleanOptionalAction, default=None, help=text.replace("%", "%%")
            )
        else:
            parser.add_argument(option, metavar=_placeholder(sort), default=None, help=text.replace("%", "%%"))
    given = vars(parser.parse_args(arguments))
    config: Path | None = given.pop("config")
    values: dict[str, Any] = {}
    if config is not None:
        _merge(kind, values, _read(config), str(config))
    from_environment = {field: environment.get(PREFIX + field.upper()) for field in described}
    _merge(kind, values, {key: value for key, value in from_environment.items() if value is not None}, "environment")
    _merge(kind, values, {key: value for key, value in given.items() if value is not None}, "command line")
    for field in msgspec.structs.fields(kind):
        if field.required and field.name not in values:
            option, variable = field.name.replace("_", "-"), PREFIX + field.name.upper()
            raise InvalidRequest(
                f"setting {field.name} is missing: give --{option}, {variable}, or {field.name} in the --config file"
            )
    try:
        return msgspec.convert(values, kind, strict=False, dec_hook=path_hook)
    except msgspec.ValidationError as error:
        raise InvalidRequest(f"{program}: {error}") from None


def load_or_exit(kind: type[S], program: str, arguments: Sequence[str] | None = None) -> S:
    """Load the settings in a main function; on an error, print it and exit with status 2, as argparse does."""
    try:
        return load(kind, program, sys.argv[1:] if arguments is None else arguments)
    except InvalidRequest as error:
        print(f"{program}: {error}", file=sys.stderr)
        raise SystemExit(2) from None


def _expected(sort: msgspec.inspect.Type) -> str:
    """Return the values that a setting of this type may have, if they are few."""
    if isinstance(sort, msgspec.inspect.LiteralType):
        return f"must be one of {_placeholder(sort)[1:-1]}"
    return "must be true or false" if isinstance(sort, msgspec.inspect.BoolType) else ""


def _default(field: msgspec.structs.FieldInfo) -> str:
    """Return the default value for the help text; empty and false defaults are not shown."""
    if field.required:
        return " (required)"
    # Lists are the only defaults that msgspec makes with a factory.
    fixed = field.default_factory is msgspec.NODEFAULT
    value = field.default if fixed else ",".join(field.default_factory())
    return "" if value is None or value is False or value == "" else f" (default: {value})"


def _placeholder(sort: msgspec.inspect.Type) -> str:
    """Return the placeholder for a value of this type in the help text."""
    match sort:
        case msgspec.inspect.LiteralType(values=values):
            return "{" + ",".join(map(str, values)) + "}"
        case msgspec.inspect.IntType() | msgspec.inspect.FloatType():
            return "N"
        case msgspec.inspect.CustomType():  # msgspec does not know paths
            return "PATH"
        case msgspec.inspect.UnionType(types=types):
            return _placeholder(types[0])
        case msgspec.inspect.ListType():
            return "LIST"
    return "VALUE"


def _described(annotation: Any) -> tuple[msgspec.inspect.Type, str]:
    """Return the type of a field without its metadata, and its description."""
    kind = msgspec.inspect.type_info(annotation)
    description = ""
    while isinstance(kind, msgspec.inspect.Metadata):
        description = str((kind.extra_json_schema or {}).get("description", description))
        kind = kind.type
    return kind, description


def _read(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text())
    except OSError as error:
        raise InvalidRequest(f"settings file {describe_os_error(error)}") from None
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InvalidRequest(f"settings file {path} is not TOML: {error}") from None


def _merge(kind: type[msgspec.Struct], into: dict[str, Any], values: Mapping[str, Any], source: str) -> None:
    fields = {field.name: field.type for field in msgspec.structs.fields(kind)}
    for key, value in values.items():
        if key not in fields:
            raise InvalidRequest(f"{source}: unknown setting {key!r}; the settings are {', '.join(sorted(fields))}")
        if isinstance(value, str) and isinstance(_described(fields[key])[0], msgspec.inspect.ListType):
            value = [part for part in value.split(",") if part]
        try:
            into[key] = msgspec.convert(value, fields[key], strict=False, dec_hook=path_hook)
        except msgspec.ValidationError as error:
            problem = _expected(_described(fields[key])[0]) or error
            raise InvalidRequest(f"{source}: setting {key} = {value!r}: {problem}", field=key) from None
