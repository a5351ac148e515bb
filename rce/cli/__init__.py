"""The command `rce`: command line, interactive console, help and completion, all made from one table.

`table.py` lists every command and program; `commands/` holds their declarations, a module for each family, and the
functions of the commands that only call the HTTP API. `lazy/` holds what needs slow imports (asyncio, numpy, the robot
client); a module there is imported when its command runs, so that a list command starts in a tenth of a second.

Clients of the platform's APIs are in `rce.client` and `rce.api.client`; no other package needs this one to run.
"""
