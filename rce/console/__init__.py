"""The commands of the console: one table, from which the command line, the interactive console, help and completion
are made.
"""
