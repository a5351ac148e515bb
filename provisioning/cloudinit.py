"""User data for cloud-init. Standard library only.

The instance fetches RCE's source from the Master that it joins, over TLS with the given CA. So it needs no checkout and
always has the Master's version.
"""

from __future__ import annotations

import json
import shlex
from urllib.parse import urljoin

from provisioning.joincode import Code

CA, CODE = "/etc/rce/bootstrap-ca.pem", "/etc/rce/join-code"
SOURCE = "/usr/local/src/rce"
PACKAGES = ("python3", "python3-venv", "ca-certificates", "curl")


def user_data(code: Code, authority: str, options: str = "") -> str:
    """Return a cloud-config. It contains the join code, which is a secret until the instance has used it."""
    fetch = f"curl --fail --silent --show-error --retry 10 --retry-all-errors --cacert {CA}"
    words = shlex.join(["--role", ",".join(code.roles), "--name", code.name, *shlex.split(options)])
    commands = [
        f"mkdir -p {SOURCE}",
        f"{fetch} --output {SOURCE}.tar.gz {shlex.quote(urljoin(code.url, 'source'))}",
        f"tar -xzf {SOURCE}.tar.gz -C {SOURCE}",
        f'{SOURCE}/provisioning/provision install {words} --join "$(cat {CODE})"',
        f"rm -f {CODE} {CA}",
        f"{SOURCE}/provisioning/provision doctor",
    ]
    config = {
        "hostname": code.name,
        "package_update": True,
        "packages": list(PACKAGES),
        "write_files": [
            {"path": CA, "permissions": "0644", "content": authority},
            {"path": CODE, "permissions": "0600", "content": code.text},
        ],
        "runcmd": [["sh", "-ec", "\n".join(commands)]],
    }
    return "#cloud-config\n" + "".join(f"{key}: {json.dumps(value)}\n" for key, value in config.items())
