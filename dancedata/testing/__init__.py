"""For tests of plug-ins: conformance checks, small stores."""
