"""Helpers of the tests: platforms, fakes, drivers. No test module stands here, and none is imported from another."""
