"""The engine `swarm`: environments as services of a Docker Swarm, with an agent on each node."""
