"""The demo of the report's tests."""

from tests.report.conftest import demo  # noqa: F401
