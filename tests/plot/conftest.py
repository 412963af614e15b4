"""The datasets of the reports' tests."""

from tests.report.conftest import demo, relabelled  # noqa: F401 (fixtures)
