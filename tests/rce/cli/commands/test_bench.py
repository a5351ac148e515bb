"""Arguments of `rce bench`."""

from __future__ import annotations

import subprocess
import sys

from rce.bench.routes import DEFAULT_ROUTES, ROUTES
from rce.cli import table
from rce.cli.command import parser


def test_default_routes_need_one_machine_only() -> None:
    args = parser(table.COMMANDS["bench rtt"]).parse_args([])
    assert args.routes == ",".join(DEFAULT_ROUTES)
    assert set(args.routes.split(",")) <= set(ROUTES)
    assert "c2c2" not in args.routes


def test_table_of_commands_does_not_import_the_benchmarks() -> None:
    code = "import sys; import rce.cli.table; print([name for name in sys.modules if name.startswith('rce.bench')])"
    ended = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, timeout=30, check=True)
    assert ended.stdout == "[]\n"
