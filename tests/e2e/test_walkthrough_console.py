"""The walk of docs/walkthrough-console.md, as it stands there, from a fresh platform."""

from __future__ import annotations

import asyncio
import re
from pathlib import Path

from consoles import OnTerminal, surroundings
from real_platform import RCE, RealPlatform
from transcripts import play, steps

DOCUMENT = Path(__file__).parents[2] / "docs" / "walkthrough-console.md"


async def test_the_walk_by_the_console(tmp_path: Path) -> None:
    async with RealPlatform(tmp_path, dev=False) as platform:
        found = re.search(r"'admin' with password '(\S+)'", platform.said)
        assert found, platform.said
        env = surroundings(tmp_path)
        env |= {"PATH": f"{Path(RCE).parent}:{env['PATH']}", "PS1": "<$?>", "PS2": "", "COLUMNS": "500"}
        replaced = {"http://127.0.0.1:9000/": platform.url, "ADMIN-PASSWORD": found[1]}
        await asyncio.to_thread(walk, env, replaced)


def walk(env: dict[str, str], replaced: dict[str, str]) -> None:
    shell = OnTerminal(["bash", "--norc", "--noediting", "-i"], env, columns=500)
    try:
        shell.until("<0>")
        shell.type(f"stty -echo; cd {env['HOME']}; set +m\n")
        shell.until("<0>$")
        played = [play(shell, step) for step in steps(DOCUMENT, replaced)]
        assert len(played) > 20
    finally:
        shell.close()
