"""Runtime of server processes: settings, logging, metrics, the event loop, startup and readiness.

What a single program does belongs to the package of that program.
"""
