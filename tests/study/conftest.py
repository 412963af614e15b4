"""The demo of the report's tests, and the browser of the viewer's."""

from tests.report.conftest import demo  # noqa: F401
from tests.viewer.conftest import browser  # noqa: F401
