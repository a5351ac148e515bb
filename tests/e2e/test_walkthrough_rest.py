"""The walk of docs/walkthrough-rest.md, as it stands there, on a fresh platform."""

from __future__ import annotations

import asyncio
import re
import shutil
import sys
from pathlib import Path

import pytest
from real_platform import RealPlatform

DOCUMENT = Path(__file__).parents[2] / "docs" / "walkthrough-rest.md"


@pytest.mark.skipif(shutil.which("curl") is None, reason="needs curl")
async def test_the_walk_by_http(tmp_path: Path) -> None:
    script = "".join(re.findall(r"```sh\n(.*?)```", DOCUMENT.read_text(), re.S))
    async with RealPlatform(tmp_path, dev=False) as platform:
        found = re.search(r"'admin' with password '(\S+)'", platform.said)
        assert found, platform.said
        path = f"{Path(sys.executable).parent}:/usr/local/bin:/usr/bin:/bin"
        bash = await asyncio.create_subprocess_exec(
            *("bash", "-exuc", script),  # no pipefail: what is refused makes curl fail, and is looked at
            env={"PATH": path, "URL": platform.url.rstrip("/"), "ADMIN": found[1]},
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.STDOUT,
        )
        output, _ = await asyncio.wait_for(bash.communicate(), 90)
        assert bash.returncode == 0, output.decode()[-4000:]
