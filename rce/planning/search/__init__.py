"""Compiled searches, and the clock that stops them. The kernels release the GIL and are compiled at import."""
