import pytest

pytest.register_assert_rewrite("tests.support")  # failures of contract suites show the values that they compare
