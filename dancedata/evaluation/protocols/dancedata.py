"""The protocol of this project, for new work."""

from dancedata.core.dance import MusicBeats
from dancedata.evaluation.protocol import PROTOCOLS, Measure, MotionRule, MusicRule, Pieces, Protocol
from dancedata.metrics.beats import BeatAlignment
from dancedata.metrics.foot_skating import FootSkating
from dancedata.metrics.geometric_features import Geometric
from dancedata.metrics.kinetic_features import Kinetic
from dancedata.metrics.physical_contact import Pfc
from dancedata.scene.poses import Pose

_JOINTS = 22


@PROTOCOLS.register("dancedata")
class Dancedata(Protocol):
    """The recommended protocol: constants in seconds and metres, without the slips, the same at any frame rate."""

    version = 2
    citation = (
        "dancedata, protocol dancedata, version 2; with Li et al. 2021 (features), Siyao et al. 2022 (beats), "
        "Tseng et al. 2023 (PFC) and Li et al. 2024 (skating)."
    )
    source = "this project"
    licence_note = "MIT."
    motion = MotionRule("body22", None)
    truth = generated = Pieces(seconds=(5, 2.5))
    measures = (
        Measure(Kinetic("fixed", joints=_JOINTS, statistics="varying"), steady=True),
        Measure(Geometric(joints=_JOINTS, statistics="varying"), steady=True),
        Measure(BeatAlignment(joints=_JOINTS)),
        Measure(Pfc("rescaled"), steady=True),
        Measure(FootSkating("speed"), steady=True),
    )
    music = MusicRule(("librosa35", "bailando438"))
    notes = (
        "all is measured at 120 frames per second, beats at their instants; numbers of version 1 do not compare",
        "pieces of 5 s every 2.5 s, so that clips of different lengths compare; intervals draw whole clips",
        "features that are the same in all clips of the pool do not count",
        "the 22 joints that SMPL and SMPL-X share, on the dancer's own bones",
    )

    def clip_scores(self, pose: Pose, beats: MusicBeats | None) -> dict[str, float | None]:
        """Return the scores of one clip that need no pool, by name; DataError if the clip cannot be measured."""
        from dancedata.evaluation.report import scores_of_clip

        return scores_of_clip(self, pose, beats)
