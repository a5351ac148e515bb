"""The examples of docs/api.md run as they stand, on a fresh platform for development."""

from __future__ import annotations

import asyncio
import re
import shutil
import sys
from pathlib import Path

import pytest

from tests.support.e2e.real_platform import RealPlatform
from tests.support.paths import ROOT

EXAMPLES = re.compile(r"```sh\n(URL=.*?)```", re.S)


@pytest.mark.skipif(shutil.which("curl") is None, reason="needs curl")
async def test_examples_of_the_api(fragile: RealPlatform, tmp_path: Path) -> None:
    (script,) = EXAMPLES.findall((ROOT / "docs" / "api.md").read_text())
    path = f"{Path(sys.executable).parent}:/usr/local/bin:/usr/bin:/bin"
    bash = await asyncio.create_subprocess_exec(
        *("bash", "-m", "-euxo", "pipefail", "-c", script),
        env={"PATH": path, "URL": fragile.url.rstrip("/"), "HOME": str(tmp_path)},
        cwd=tmp_path,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.STDOUT,
    )
    output, _ = await asyncio.wait_for(bash.communicate(), 400)
    assert bash.returncode == 0, output.decode()[-4000:]
