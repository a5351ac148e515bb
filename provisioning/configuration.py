"""The settings of the services, `/etc/rce/ROLE.toml`: what is there stays unless an option says otherwise.

Standard library only.
"""

from __future__ import annotations

import json
import secrets
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from provisioning.joincode import Code
from provisioning.release import TYPESUPPORT
from provisioning.steps import Failed
from provisioning.system import AUTHORITY_KEY, CURRENT, DOCKER, ETC, MAPS, TLS, VAR, System

Value = str | int | float | bool | list[str]
Settings = dict[str, Value]
MEMBERSHIP = f"{ETC}/membership.json"  # what the Master gave when this machine joined
CONTROL_PORT, MACHINES_PORT, HTTP_PORT, WS_PORT, MAPS_PORT = 8080, 8081, 9000, 9010, 9040
DATA_PORTS = {"robot": 9020, "container": 9030}
CHANGES = {  # option: the settings that it decides, also where a file says otherwise
    "address": {"address", "public_url", "data_address", "master"},
    "http_port": {"http", "entry"},
    "ws_port": {"ws_port", "public_url"},
    "engine": {"engine"},
    "allow_unisolated": {"allow_unisolated"},
    "size": {"size"},
    "certificate": {"http", "certificate", "private_key", "trust"},
}
FROM_THE_MASTER = {"master", "token", "name", "data_address"}


@dataclass(frozen=True)
class Wanted:
    """What the installation is asked for; an option that was not given is None."""

    roles: tuple[str, ...]
    name: str
    address: str
    options: Mapping[str, str | int | None] = field(default_factory=dict)
    code: Code | None = None

    def option(self, name: str, default: str) -> str:
        value = self.options.get(name)
        return default if value is None else str(value)

    @property
    def engine(self) -> str:
        return self.option("engine", "docker")

    @property
    def uses_docker(self) -> bool:
        return self.engine in DOCKER


def settings(wanted: Wanted, system: System) -> dict[str, Settings]:
    """What the files of the roles shall say. Failed if one cannot be read."""
    found = {role: read(system, role) for role in wanted.roles}
    given = {name for option, names in CHANGES.items() if wanted.options.get(option) is not None for name in names}
    membership = read_membership(system)
    make = {"master": _master, "robot": _robot, "container": _container, MAPS: _maps}
    result = {}
    for role in wanted.roles:
        defaults = make[role](wanted) | _membership(membership, role)
        always = given | (FROM_THE_MASTER if membership else set())
        result[role] = defaults | {name: value for name, value in found[role].items() if name not in always}
    if "master" in result:
        _invite(result, found)
    return result


def read(system: System, role: str) -> Settings:
    name = f"{ETC}/{role}.toml"
    try:
        return tomllib.loads(system.text(name))
    except tomllib.TOMLDecodeError as error:
        raise Failed(f"{name}: {error}; mend it, or remove it to have it written anew") from None


def read_membership(system: System) -> dict[str, Any]:
    """As in rce/joining.py; empty if this machine has not joined one elsewhere."""
    text = system.text(MEMBERSHIP)
    result: dict[str, Any] = json.loads(text) if text else {}
    return result


def text(role: str, values: Settings) -> str:
    """As TOML."""
    head = (
        f"# Settings of `rce {role}`; `rce {role} --help` explains them. Written by `provision install`, which keeps\n"
    )
    head += "# what you change here.\n"
    return head + "".join(f"{name} = {_toml(value)}\n" for name, value in values.items())


def _toml(value: Value) -> str:
    """JSON's strings, numbers and lists are TOML's as well."""
    return json.dumps(value, ensure_ascii=False)


def _master(wanted: Wanted) -> Settings:
    return {
        "data_dir": f"{VAR}/master",
        "http": _https(wanted),
        "control": f"tcp:{CONTROL_PORT}",
        "tls": TLS,
        "machines": f"tcp:{MACHINES_PORT}",
        "authority_key": AUTHORITY_KEY,
        "address": wanted.address,
        "source": f"{CURRENT}/source.tar.gz",
        "tokens": [],
    }


def _https(wanted: Wanted) -> str:
    certificate, key = _certificate(wanted)
    port = wanted.option("http_port", str(HTTP_PORT))
    return f"ssl:{port}:privateKey={key}:certKey={certificate}"


def _certificate(wanted: Wanted) -> tuple[str, str]:
    """What robots see: the operator's own certificate, else that of the machine."""
    certificate = wanted.option("certificate", f"{TLS}/cert.pem")
    return certificate, wanted.option("private_key", f"{TLS}/key.pem")


def _robot(wanted: Wanted) -> Settings:
    certificate, key = _certificate(wanted)
    port = int(wanted.option("ws_port", str(WS_PORT)))
    return {
        "data_dir": f"{VAR}/robot",
        "name": f"{wanted.name}-robot",
        "ws_host": "0.0.0.0",
        "ws_port": port,
        "public_url": f"wss://{wanted.address}:{port}/",
        "certificate": certificate,
        "private_key": key,
        **_common(wanted, "robot"),
    }


def _container(wanted: Wanted) -> Settings:
    values: Settings = {
        "data_dir": f"{VAR}/container",
        "name": wanted.name,
        "engine": wanted.engine,
        "size": int(wanted.option("size", "10")),
        **_common(wanted, "container"),
    }
    if not wanted.uses_docker:
        unisolated = bool(wanted.options.get("allow_unisolated"))
        values |= {"typesupport": f"{TYPESUPPORT}/current", "allow_unisolated": unisolated}
    return values


def _maps(wanted: Wanted) -> Settings:
    """Its jobs come back as robots, to every machine's Robot endpoint."""
    certificate, key = _certificate(wanted)
    return {
        "data_dir": f"{VAR}/{MAPS}",
        "master": f"tcp:127.0.0.1:{CONTROL_PORT}",
        "token": "",
        "tls": TLS,
        "entry": f"https://127.0.0.1:{wanted.option('http_port', str(HTTP_PORT))}/",
        "trust": wanted.option("certificate", f"{TLS}/ca.pem"),
        "host": "0.0.0.0",
        "port": MAPS_PORT,
        "public_url": f"https://{wanted.address}:{MAPS_PORT}/",
        "certificate": certificate,
        "private_key": key,
    }


def _common(wanted: Wanted, role: str) -> Settings:
    return {
        "master": f"tcp:127.0.0.1:{CONTROL_PORT}",
        "token": "",
        "tls": TLS,
        "data_host": "0.0.0.0",
        "data_port": DATA_PORTS[role],
        "data_address": wanted.address,
    }


def _membership(membership: Mapping[str, Any], role: str) -> Settings:
    if role not in membership.get("tokens", {}):
        return {}
    return {
        "master": f"tcp:{membership['master']}",
        "token": membership["tokens"][role],
        "name": membership["names"][role],
        "data_address": membership["address"],
    }


def _invite(result: dict[str, Settings], found: Mapping[str, Settings]) -> None:
    """On the Master's machine the others have tokens that stand on both sides."""
    tokens = list(result["master"]["tokens"])  # type: ignore[arg-type]  # it is the list of strings
    for role in result.keys() - {"master"}:
        values = result[role]
        if not values["token"]:
            values["token"] = secrets.token_hex(32)
            whose = f"service:{MAPS}" if role == MAPS else f"{role}:{values['name']}"
            tokens.append(f"{whose}:{values['token']}")
    result["master"]["tokens"] = tokens
