"""The engine `process`, which runs environments as process trees on this machine, without isolation."""
