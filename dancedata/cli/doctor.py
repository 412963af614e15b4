"""dancedata doctor: prints what is found as it is found."""

from __future__ import annotations

from collections import Counter

import typer

from dancedata.core.text import counted, json_text
from dancedata.doctor.diagnosis import diagnose
from dancedata.doctor.finding import Finding


def run_doctor(*, as_json: bool) -> bool:
    """Check the installation and print a line for each check, or JSON at the end; tell whether it works."""
    findings: list[Finding] = []
    for finding in diagnose():
        findings.append(finding)
        if not as_json:
            typer.echo(str(finding))
    count = Counter(finding.status for finding in findings)
    works = not count["failed"]
    if as_json:
        typer.echo(json_text({"ok": works, "checks": [finding.to_json() for finding in findings]}))
    elif works:
        typer.echo(f"this installation works ({counted(count['note'], 'note')})")
    else:
        typer.echo(f"{counted(count['failed'], 'check')} failed")
    return works
