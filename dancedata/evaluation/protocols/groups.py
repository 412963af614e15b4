"""Protocols of groups and duets: all dancers of a group are measured together."""

from types import MappingProxyType

from dancedata.evaluation.protocol import PROTOCOLS, Measure, MotionRule, MusicRule, Pieces, Protocol
from dancedata.metrics.beats import BeatAlignment
from dancedata.metrics.group_scores import (
    BeatEcho,
    Collisions,
    ContactSpans,
    DuetDistances,
    GroupCorrelation,
    GroupKinetic,
    RootDistances,
)

_JOINTS = 22
_CAPSULES = "TIF and collisions are of capsules round the limbs; published TIF is of meshes and does not compare"


@PROTOCOLS.register("groups")
class Groups(Protocol):
    """Groups and duets, for new work: all metrics of them, at any frame rate, in pieces of 5 s."""

    version = 1
    citation = (
        "dancedata, protocol groups, version 1; with Le et al. 2023 (GMR, GMC, TIF) and Siyao et al. 2024 (FID_cd, "
        "BED)."
    )
    source = "this project"
    licence_note = "MIT."
    motion = MotionRule("body22", None)
    truth = generated = Pieces(seconds=(5, 2.5))
    measures = (
        Measure(GroupKinetic(joints=_JOINTS, statistics="varying"), steady=True),
        Measure(GroupCorrelation(joints=_JOINTS), steady=True),
        Measure(BeatAlignment(joints=_JOINTS)),
        Measure(RootDistances()),
        Measure(Collisions()),
        Measure(ContactSpans()),
        Measure(DuetDistances(statistics="varying")),
        Measure(BeatEcho()),
    )
    music = MusicRule(("librosa35", "bailando438"))
    notes = (
        "BAS is the mean over the dancers of a group; its beats, and those of BED, are at their instants",
        "BED is of a duet whose first dancer is the follower; other groups have none, and no FID_cd",
        "features that are the same in all groups of the pool do not count",
        "GMC grows with the speed of the dance: compare it for the same music",
        _CAPSULES,
    )


@PROTOCOLS.register("gcd-groups")
class GcdGroups(Protocol):
    """GCD, groups: GMR, GMC and the beats of all dancers, absolute positions at 30 frames per second."""

    version = 1
    citation = "Le et al., Controllable Group Choreography Using Contrastive Diffusion, SIGGRAPH Asia 2023."
    source = "aioz-ai/GCD b9524d8, eval/calculate_gmr_scores.py, calculate_gmc_scores.py, calculate_beat_scores.py"
    licence_note = "MIT (code)."
    pool_split = "all"
    motion = MotionRule("smpl24", 30, pelvis="body")
    measures = (
        Measure(GroupKinetic()),
        Measure(GroupCorrelation()),
        Measure(BeatAlignment("gcd", "motion", 2.12, unit="frames", cut="frames", no_motion_beats="zero")),
        Measure(Collisions()),
    )
    music = MusicRule(("librosa35",), 30)
    notes = (
        "BAS is the mean over the dancers of each group, then over groups",
        "beats are the program's: of motion half a frame (16.7 ms) late, of music a row (33.3 ms) late",
        _CAPSULES,
    )
    not_computable = MappingProxyType({"fid_k": "of dancers one by one: the protocol gcd"})


@PROTOCOLS.register("duolando")
class Duolando(Protocol):
    """Duolando, duets on SMPL-X: distances of follower and leader and their beats, at 30 frames per second."""

    version = 1
    citation = "Siyao et al., Duolando: Follower GPT with Off-Policy Reinforcement Learning, ICLR 2024."
    source = "lisiyao21/Duolando abb93e6, utils/metrics_duet.py"
    licence_note = "see the repository; none of its code is used here."
    pool_split = "all"
    motion = MotionRule("smplx55", 30)
    measures = (Measure(DuetDistances()), Measure(BeatEcho("bailando")))
    notes = (
        "the first dancer is the follower; the frames that both have are measured",
        "beats are the program's, of all 55 joints, half a frame (16.7 ms) early",
    )
    not_computable = MappingProxyType(
        {"fid_k, fid_g, bas": "of the follower alone: evaluate followers under a protocol of single dancers"}
    )
