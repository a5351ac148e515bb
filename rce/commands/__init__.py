"""The commands that `rce` carries out itself, each imported when it is called."""
