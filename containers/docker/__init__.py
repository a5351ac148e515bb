"""The engine `docker`, which runs environments as containers of one machine.

Modules here may be used by the engine `swarm`, whose agents do on their node what this engine does on its machine; code
for services and nodes of a swarm belongs in `containers.swarm`.
"""
