"""Program that carries out a launch file: `python -P -m endpoints.environment.launch.interpreter REQUEST RESULT`.

REQUEST is a JSON file with `file`, `arguments` and `packages`; RESULT becomes one with `nodes` or `error`.
"""

from __future__ import annotations

import json
import sys
import traceback
from pathlib import Path
from typing import Any

from endpoints.environment.launch.interpreter.context import Context, LaunchError
from endpoints.environment.launch.interpreter.files import LaunchDescriptionSource
from endpoints.environment.launch.interpreter.modules import install


def interpret(request: dict[str, Any]) -> dict[str, Any]:
    """Return the nodes that a launch file describes, or the error."""
    context = Context(request["packages"], request["arguments"])
    install(context)
    try:
        LaunchDescriptionSource(request["file"]).visit(context)
        check_arguments(context)
    except LaunchError as error:
        return {"error": str(error)}
    except Exception as error:  # noqa: BLE001  # of the user's code
        traceback.print_exc()
        return {"error": f"{Path(request['file']).name}: {type(error).__name__}: {error}"}
    return {"nodes": context.nodes}


def check_arguments(context: Context) -> None:
    """Raise LaunchError for an argument that the launch file neither declares nor reads."""
    unknown = context.arguments.keys() - context.declared.keys() - context.read
    if unknown:
        known = ", ".join(sorted(context.declared)) or "no arguments"
        raise LaunchError(f"the launch file has no argument {', '.join(sorted(unknown))}; it has {known}")


def main() -> None:
    """Carry out the launch file of the command line."""
    request, result = map(Path, sys.argv[1:3])
    found = interpret(json.loads(request.read_text()))
    partial = result.with_suffix(".partial")
    partial.write_text(json.dumps(found))
    partial.rename(result)


if __name__ == "__main__":
    main()
