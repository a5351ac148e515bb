"""The control calls between the processes: what each may ask of which, with its arguments and its result.

Sets of names cross, never counters, and every call may be made twice: what is there already stays as it is. After each
(re)connection a process says what it really has (`joining.Hello`), and the Master answers with what is wanted
(`endpoints.Sync`, `environments.KeepEnvironments`). Times are seconds, sizes bytes.
"""
