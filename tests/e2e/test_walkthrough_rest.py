"""The commands of docs/walkthrough-rest.md on a fresh platform."""

from __future__ import annotations

import asyncio
import re
import shutil
import sys
from pathlib import Path

import pytest

from tests.support.e2e.real_platform import RealPlatform
from tests.support.paths import ROOT

DOCUMENT = ROOT / "docs" / "walkthrough-rest.md"


@pytest.mark.skipif(shutil.which("curl") is None, reason="needs curl")
async def test_walkthrough(tmp_path: Path) -> None:
    script = "".join(re.findall(r"```sh\n(.*?)```", DOCUMENT.read_text(), re.S))
    async with RealPlatform(tmp_path, dev=False) as platform:
        found = re.search(r"'admin' with password '(\S+)'", platform.output)
        assert found, platform.output
        path = f"{Path(sys.executable).parent}:/usr/local/bin:/usr/bin:/bin"
        bash = await asyncio.create_subprocess_exec(
            *("bash", "-exuc", script),  # no pipefail: curl fails for refused requests, whose answers are read
            env={"PATH": path, "URL": platform.url.rstrip("/"), "ADMIN": found[1]},
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.STDOUT,
        )
        output, _ = await asyncio.wait_for(bash.communicate(), 300)
        assert bash.returncode == 0, output.decode()[-4000:]
