"""The list of protocols, as text and JSON."""

import inspect
from typing import Any

from dancedata.evaluation.protocol import PROTOCOLS, Protocol
from dancedata.evaluation.report import LABELS
from dancedata.files.documents import document_of


def protocols_json() -> dict[str, Any]:
    """Return every protocol with all that its numbers depend on."""
    return {name: _protocol_json(PROTOCOLS.get(name)()) for name in PROTOCOLS.names()}


def _protocol_json(protocol: Protocol) -> dict[str, Any]:
    rule, music = protocol.motion, protocol.music
    return {
        "version": protocol.version,
        "about": (inspect.getdoc(type(protocol)) or "").split("\n\n")[0].replace("\n", " "),
        "citation": protocol.citation,
        "source": protocol.source,
        "licence": protocol.licence_note,
        "motion": {"body": rule.body, "fps": rule.fps, "up": rule.up, "pelvis": rule.pelvis},
        "truth": str(protocol.truth),
        "generated": str(protocol.generated),
        "metrics": [{m.metric.name: document_of(m.metric), "fps": m.fps} for m in protocol.measures],
        "music": None
        if music is None
        else {"features": list(music.features), "fps": music.fps, "by_piece": music.by_piece},
        "published": [
            {"what": p.what, "values": dict(p.values), "source": p.source, "note": p.note} for p in protocol.published
        ],
        "not_computable": dict(protocol.not_computable),
        "notes": list(protocol.notes),
    }


def describe_protocols(only: str | None = None) -> str:
    """Return the output of ``dancedata info protocols``, or of ``dancedata info PROTOCOL``."""
    lines = []
    for name, protocol in protocols_json().items():
        if only not in (None, name):
            continue
        motion = protocol["motion"]
        rate = f"{motion['fps']} frames per second" if motion["fps"] else "any frame rate"
        lines += [
            f"{name}, version {protocol['version']}: {protocol['about']}",
            f"  {motion['body']}, {rate}, {motion['up']} up",
        ]
        lines.append(f"  ground truth: {protocol['truth']}; generated: {protocol['generated']}")
        metrics = ["".join(_call(n, d) for n, d in m.items() if n != "fps") for m in protocol["metrics"]]
        lines.append(f"  metrics: {', '.join(metrics)}")
        for row in protocol["published"]:
            values = ", ".join(f"{LABELS.get(k, k)} {v:g}" for k, v in row["values"].items())
            lines.append(f"  published, {row['what']}: {values} ({row['source']})")
        lines += [f"  note: {note}" for note in (protocol["notes"] if only else ())]
        lines.append(f"  from: {protocol['source']}")
    return "\n".join(lines)


def _call(name: str, parameters: dict[str, Any]) -> str:
    return f"{name}({', '.join(f'{v}' for v in parameters.values() if isinstance(v, str))})"
