"""All checks of an installation in their order."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from dancedata.core.packages import requirements
from dancedata.doctor.finding import Finding, failed
from dancedata.doctor.packages import check_extras, check_packages, check_python

Check = Callable[[], Iterator[Finding]]


def diagnose() -> Iterator[Finding]:
    """Yield what every check found, as soon as it is known. Nothing is left behind.

    A check that raises, whatever it raises, has failed; the others run all the same.
    """
    required = requirements()
    yield from guarded("Python", check_python)
    yield from guarded("packages", lambda: check_packages(required))
    yield from guarded("extras", lambda: check_extras(required))
    # Imported in the checks: a package that is missing is a finding.
    yield from guarded("cache", _cache)
    yield from guarded("processor", _processor)
    yield from guarded("music", _music)
    yield from guarded("workers", _workers)
    yield from guarded("build", _sample)


def guarded(name: str, check: Check) -> Iterator[Finding]:
    """Yield what a check finds; an exception that it raises is a finding too."""
    try:
        yield from check()
    except Exception as error:  # noqa: BLE001  (a broken installation raises anything)
        yield failed(name, f"{type(error).__name__}: {error}", _fix(error))


def _fix(error: Exception) -> str:
    if isinstance(error, ImportError):
        return "pip install -c constraints.txt . installs what is missing"
    return "see the lines above; if none of them has failed, report it with the output of doctor --json"


def _cache() -> Iterator[Finding]:
    from dancedata.doctor.machine import check_cache

    yield from check_cache()


def _processor() -> Iterator[Finding]:
    from dancedata.doctor.machine import check_processor

    yield from check_processor()


def _music() -> Iterator[Finding]:
    from dancedata.doctor.machine import check_music

    yield from check_music()


def _workers() -> Iterator[Finding]:
    from dancedata.doctor.machine import check_workers

    yield from check_workers()


def _sample() -> Iterator[Finding]:
    from dancedata.doctor import sample

    with tempfile.TemporaryDirectory(prefix="dancedata-doctor-") as folder:
        dataset = sample.build_sample(Path(folder))
        known = sample.reference()
        for name, check in (
            ("bytes", lambda: sample.check_bits(dataset, known)),
            ("numbers", lambda: sample.check_numbers(dataset, known)),
            ("reading", lambda: sample.check_reading(dataset)),
            ("torch", lambda: sample.check_torch(dataset)),
        ):
            yield from guarded(name, check)
