"""Words of the node; found only if the package is installed."""


def greeting(name: str) -> str:
    return f"hello {name}"
