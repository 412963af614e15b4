"""EDGE's evaluation on AIST++, the released part."""

from types import MappingProxyType

from dancedata.evaluation.protocol import PROTOCOLS, Measure, MotionRule, Pieces, Protocol, Published
from dancedata.metrics.physical_contact import Pfc

_NOT_RELEASED = "EDGE's code for it was never released; dgsdp is the nearest open one"


@PROTOCOLS.register("edge-aistpp")
class EdgeAistpp(Protocol):
    """EDGE on AIST++: PFC of pieces of five seconds at 30 frames per second, z up."""

    version = 1
    citation = "Tseng, Castellon, Liu, EDGE: Editable Dance Generation From Music, CVPR 2023."
    source = "Stanford-TML/EDGE 17c3428, eval/eval_pfc.py; the stride of 2.5 s is the paper's (EDGE#24)"
    licence_note = "MIT."
    motion = MotionRule("smpl24", 30, "z")
    truth = Pieces(length=150, stride=75)
    generated = Pieces(length=150, stride=75)
    measures = (Measure(Pfc("code", "z")),)
    published = (
        Published(
            "ground truth",
            {"pfc": 1.332, "bas": 0.24, "div_k": 10.61, "div_g": 7.48},
            "EDGE, table 1",
            "only PFC has code; with other slices users get other values (EDGE#24)",
            dataset="aist++",
            splits=("test",),
        ),
    )
    notes = (
        "PFC depends on the length of the pieces: 1.33, 1.04 and 1.7 are published for 5, 7.5 and 10 s (PAMD)",
        "its mean has heavy tails: one jump of a tracker can double it, so read the median too",
    )
    not_computable = MappingProxyType({"bas": _NOT_RELEASED, "div_k": _NOT_RELEASED, "div_g": _NOT_RELEASED})
