"""The summary after `provision install`."""

from __future__ import annotations

from provisioning import (
    install,
    summary,
)
from provisioning.configuration import Installation
from provisioning.system import System
from tests.support.provisioning.systems import options, write_settings


def test_all_ports_are_listed(debian: System) -> None:
    values = write_settings(debian, "--ws-port", "9999", "--http-port", "443")
    installation = install.planned_installation(options("--ws-port", "9999", "--http-port", "443"), debian)
    listed = {port for port, _, _ in summary.ports(installation)}
    maps = values["map-service"]
    assert (maps["entry"], maps["public_url"]) == (
        "https://127.0.0.1:443/",
        f"https://{installation.address}:{maps['port']}/",
    )
    ports = {values["robot"]["data_port"], values["container"]["data_port"], maps["port"]}
    ports |= {values["knowledge-service"]["port"]}
    assert listed == {443, 9999, 8080, 8081, *ports}
    assert "9999   from robots" in summary.firewall_ports(installation)


def test_commands_to_start_without_systemd(debian: System) -> None:
    text = summary.next_steps(debian, Installation(("master", "container"), "alpha", "10.0.0.1", {"engine": "docker"}))
    assert "runuser -u rce -g rce -- /opt/rce/current/bin/rce master --config /etc/rce/master.toml" in text
    words = "setpriv --reuid rce --regid rce --groups docker --inh-caps -all,+net_admin --ambient-caps -all,+net_admin"
    assert f"{words} --no-new-privs /opt/rce/current/bin/rce container" in text
