"""Helpers for tests, public: small stores and the conformance checks of plug-ins."""
