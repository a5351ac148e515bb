"""Persistent state of the Master: the database and the archives of packages."""
