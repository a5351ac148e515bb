"""Control calls between the processes, with their arguments and results.

Calls carry sets of names, never counters, and are idempotent: a repeated call changes nothing. After each
(re)connection a process reports its actual state (`joining.Hello`), and the Master reconciles it with the desired state
(`endpoints.Sync`, `environments.KeepEnvironments`). Times are in seconds, sizes in bytes.

Only types belong here; handlers belong to the processes that answer the calls. Docstrings name the errors that a call
raises at the caller.
"""
