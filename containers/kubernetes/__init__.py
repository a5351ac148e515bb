"""The engine `kubernetes`: environments as pods of a cluster, with an agent on each node.

Modules that make objects for Kubernetes' API (`objects`, `pod`, `policies`, `daemonset`) are pure; only `api` talks to
it. What an agent does that is no matter of Kubernetes belongs in `containers.agents`.
"""
