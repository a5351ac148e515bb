"""Settings of the services, `/etc/rce/ROLE.toml`. Settings in a file are kept unless an option overrides them.

Standard library only.
"""

from __future__ import annotations

import json
import secrets
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from provisioning.joincode import Code
from provisioning.release import TYPESUPPORT
from provisioning.steps import ProvisioningError
from provisioning.system import AUTHORITY_KEY, CURRENT, DOCKER, ETC, KNOWLEDGE, MAPS, TLS, VAR, WEB_SERVICES, System

Value = str | int | float | bool | list[str]
Settings = dict[str, Value]
MEMBERSHIP = f"{ETC}/membership.json"  # the Master's answer when this machine joined
CONTROL_PORT, MACHINES_PORT, HTTP_PORT, WS_PORT = 8080, 8081, 9000, 9010
DATA_PORTS = {"robot": 9020, "container": 9030}
WEB_PORTS = {MAPS: 9040, KNOWLEDGE: 9050}
OVERRIDES = {  # option: the settings that it overrides
    "address": {"address", "public_url", "data_address", "master"},
    "http_port": {"http", "entry"},
    "ws_port": {"ws_port", "public_url"},
    "engine": {"engine"},
    "allow_unisolated": {"allow_unisolated"},
    "size": {"size"},
    "certificate": {"http", "certificate", "private_key", "trust"},
    "database": {"database"},
    "masters": {"masters", "master", "entry"},
}
FROM_THE_MASTER = {"master", "token", "name", "data_address"}


@dataclass(frozen=True)
class Installation:
    """Desired state of the installation.

    Attributes:
        roles: Services of this machine.
        name: Name of this machine, unique on the platform.
        address: Host by which robots and machines reach this machine.
        options: Options of `install`; None for those that were not given.
        code: Join code, if the machine joins a platform.
    """

    roles: tuple[str, ...]
    name: str
    address: str
    options: Mapping[str, str | int | None] = field(default_factory=dict)
    code: Code | None = None

    def option(self, name: str, default: str) -> str:
        """Return the value of an option, or a default if it was not given."""
        value = self.options.get(name)
        return default if value is None else str(value)

    @property
    def masters(self) -> list[str]:
        """Hosts of the Masters, if there are several."""
        return masters(self.option("masters", ""))

    @property
    def engine(self) -> str:
        """Engine of environments."""
        return self.option("engine", "docker")

    @property
    def uses_docker(self) -> bool:
        """True if the engine needs Docker."""
        return self.engine in DOCKER


def masters(text: str) -> list[str]:
    """Return the hosts in a text that separates them by commas."""
    return [host.strip() for host in text.split(",") if host.strip()]


def settings(installation: Installation, system: System) -> dict[str, Settings]:
    """Return the desired settings of each role.

    Raises:
        ProvisioningError: A settings file cannot be read.
    """
    found = {role: read(system, role) for role in installation.roles}
    given = {
        name for option, names in OVERRIDES.items() if installation.options.get(option) is not None for name in names
    }
    membership = read_membership(system)
    make: dict[str, Callable[[Installation], Settings]] = {
        "master": _master,
        "robot": _robot,
        "container": _container,
        **{name: partial(_web, name) for name in WEB_SERVICES},
    }
    result = {}
    for role in installation.roles:
        defaults = make[role](installation) | _membership(membership, role)
        always = given | (FROM_THE_MASTER if membership else set())
        result[role] = defaults | {name: value for name, value in found[role].items() if name not in always}
    if "master" in result:
        _invite(result, found)
    return result


def read(system: System, role: str) -> Settings:
    """Read the settings file of a role; empty if there is none.

    Raises:
        ProvisioningError: The file is not TOML.
    """
    name = f"{ETC}/{role}.toml"
    try:
        return tomllib.loads(system.text(name))
    except tomllib.TOMLDecodeError as error:
        raise ProvisioningError(f"{name}: {error}; correct it, or remove it to have it written anew") from None


def read_membership(system: System) -> dict[str, Any]:
    """Read the membership (see rce/api/joining.py); empty unless this machine has joined another one's platform."""
    text = system.text(MEMBERSHIP)
    result: dict[str, Any] = json.loads(text) if text else {}
    return result


def text(role: str, values: Settings) -> str:
    """Return the settings file of a role."""
    head = (
        f"# Settings of `rce {role}`; `rce {role} --help` explains them. Written by `provision install`, which keeps\n"
    )
    head += "# your changes.\n"
    return head + "".join(f"{name} = {_toml(value)}\n" for name, value in values.items())


def _toml(value: Value) -> str:
    """Format a value by JSON, whose strings, numbers, booleans and lists are TOML too."""
    return json.dumps(value, ensure_ascii=False)


def _master(installation: Installation) -> Settings:
    return {
        "data_dir": f"{VAR}/master",
        "database": installation.option("database", ""),
        "masters": installation.masters,
        "http": _https(installation),
        "control": f"tcp:{CONTROL_PORT}",
        "tls": TLS,
        "machines": f"tcp:{MACHINES_PORT}",
        "authority_key": AUTHORITY_KEY,
        "address": installation.address,
        "source": f"{CURRENT}/source.tar.gz",
        "tokens": [],
    }


def _https(installation: Installation) -> str:
    certificate, key = _certificate(installation)
    port = installation.option("http_port", str(HTTP_PORT))
    return f"ssl:{port}:privateKey={key}:certKey={certificate}"


def _certificate(installation: Installation) -> tuple[str, str]:
    """Return the files of the certificate for robots and its key: the operator's, by default the machine's."""
    certificate = installation.option("certificate", f"{TLS}/cert.pem")
    return certificate, installation.option("private_key", f"{TLS}/key.pem")


def _robot(installation: Installation) -> Settings:
    certificate, key = _certificate(installation)
    port = int(installation.option("ws_port", str(WS_PORT)))
    return {
        "data_dir": f"{VAR}/robot",
        "name": f"{installation.name}-robot",
        "ws_host": "0.0.0.0",
        "ws_port": port,
        "public_url": f"wss://{installation.address}:{port}/",
        "certificate": certificate,
        "private_key": key,
        **_common(installation, "robot"),
    }


def _container(installation: Installation) -> Settings:
    values: Settings = {
        "data_dir": f"{VAR}/container",
        "name": installation.name,
        "engine": installation.engine,
        "size": int(installation.option("size", "10")),
        **_common(installation, "container"),
    }
    if not installation.uses_docker:
        unisolated = bool(installation.options.get("allow_unisolated"))
        values |= {"typesupport": f"{TYPESUPPORT}/current", "allow_unisolated": unisolated}
    return values


def _web(name: str, installation: Installation) -> Settings:
    """Return the defaults of a web service. Jobs of the map service connect as robots to all Robot endpoints."""
    certificate, key = _certificate(installation)
    port = installation.option("http_port", str(HTTP_PORT))
    as_robots: Settings = {
        "entry": ",".join(f"https://{host}:{port}/" for host in installation.masters or ["127.0.0.1"]),
        "trust": installation.option("certificate", f"{TLS}/ca.pem"),
    }
    return {
        "data_dir": f"{VAR}/{name}",
        "master": _control(installation),
        "token": "",
        "tls": TLS,
        **(as_robots if name == MAPS else {}),
        "host": "0.0.0.0",
        "port": WEB_PORTS[name],
        "public_url": f"https://{installation.address}:{WEB_PORTS[name]}/",
        "certificate": certificate,
        "private_key": key,
    }


def _control(installation: Installation) -> str:
    """Return the control addresses of the Masters, by default of that on this machine."""
    return ",".join(f"tcp:{host}:{CONTROL_PORT}" for host in installation.masters or ["127.0.0.1"])


def _common(installation: Installation, role: str) -> Settings:
    return {
        "master": _control(installation),
        "token": "",
        "tls": TLS,
        "data_host": "0.0.0.0",
        "data_port": DATA_PORTS[role],
        "data_address": installation.address,
    }


def _membership(membership: Mapping[str, Any], role: str) -> Settings:
    if role not in membership.get("tokens", {}):
        return {}
    return {
        "master": ",".join(f"tcp:{each}" for each in membership["master"].split(",")),
        "token": membership["tokens"][role],
        "name": membership["names"][role],
        "data_address": membership["address"],
    }


def _invite(result: dict[str, Settings], found: Mapping[str, Settings]) -> None:
    """Make tokens for the services on the Master's machine, in the Master's settings and in theirs."""
    tokens = list(result["master"]["tokens"])  # type: ignore[arg-type]  # it is the list of strings
    for role in result.keys() - {"master"}:
        values = result[role]
        if not values["token"]:
            values["token"] = secrets.token_hex(32)
            identity = f"service:{role}" if role in WEB_SERVICES else f"{role}:{values['name']}"
            tokens.append(f"{identity}:{values['token']}")
    result["master"]["tokens"] = tokens
