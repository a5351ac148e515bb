"""Parts of the engines that have an agent on each node (`swarm`, `kubernetes`).

The task set's side of the agents' connections, and what an agent does on its node whatever runs the containers there.
No module here may need docker-py or a client of Kubernetes.
"""
