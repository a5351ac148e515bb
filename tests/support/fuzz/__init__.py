"""Fuzzing of the ports: a mutator, the grammars of what robots and processes send, and what is checked."""
