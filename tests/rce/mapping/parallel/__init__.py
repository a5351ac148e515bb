"""Tests of parallel mapping."""
