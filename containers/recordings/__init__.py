"""Recordings that a task set keeps on its machine, by user: those of its environments, and uploads.

They outlive their environments. Programs in an environment reach this store by a socket only, at which they may append
to a recording that the Master permits, within the quota of their user.
"""
