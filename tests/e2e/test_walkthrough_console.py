"""The commands of docs/walkthrough-console.md, with the output shown there, from a new platform."""

from __future__ import annotations

import asyncio
import re
from pathlib import Path

from tests.support.e2e.consoles import TerminalProcess, user_environ
from tests.support.e2e.real_platform import RCE, RealPlatform
from tests.support.e2e.transcripts import play, steps
from tests.support.paths import ROOT

DOCUMENT = ROOT / "docs" / "walkthrough-console.md"


async def test_walkthrough_of_the_console(tmp_path: Path) -> None:
    async with RealPlatform(tmp_path, dev=False) as platform:
        found = re.search(r"'admin' with password '(\S+)'", platform.output)
        assert found, platform.output
        env = user_environ(tmp_path)
        env |= {"PATH": f"{Path(RCE).parent}:{env['PATH']}", "PS1": "<$?>", "PS2": "", "COLUMNS": "500"}
        replaced = {"http://127.0.0.1:9000/": platform.url, "ADMIN-PASSWORD": found[1]}
        await asyncio.to_thread(walk, env, replaced)


def walk(env: dict[str, str], replaced: dict[str, str]) -> None:
    shell = TerminalProcess(["bash", "--norc", "--noediting", "-i"], env, columns=500)
    try:
        shell.expect("<0>")
        shell.type(f"stty -echo; cd {env['HOME']}; set +m\n")
        shell.expect("<0>$")
        played = [play(shell, step) for step in steps(DOCUMENT, replaced)]
        assert len(played) > 20
    finally:
        shell.close()
