"""PhantomDance 1.2 (Li et al. 2022): dances made by animators, 260 with their music, 9.5 hours, 30 FPS.

The files: docs/datasets/phantomdance.md. Motions are in SOURCE or in one folder of it, music in any of these.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePath
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from dancedata.core.audio_signal import AUDIO_SUFFIXES
from dancedata.core.clip import ClipRef
from dancedata.core.errors import DataError, SourceError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion, world_matrices
from dancedata.core.registry import DATASETS
from dancedata.core.rotations import rotvec_from_matrix
from dancedata.core.skeleton import SMPL24_EDGE, Skeleton
from dancedata.core.text import listed, quoted
from dancedata.core.typing import override
from dancedata.datasets.checks import DOWNLOAD_AGAIN, bad_shape, read_frames, require_keys, require_upright
from dancedata.datasets.files import describe, files_by_stem, list_audio, relative, require_folder
from dancedata.datasets.published import Folders, Layout, Listing, PairedDataset
from dancedata.files.listing import list_folder
from dancedata.files.strict_json import read_json
from dancedata.formats.values import ValueArrays

RATE = 30
#: Names of SMPL's joints in the files, in SMPL's order.
_BONES = (
    "Pelvis L_Hip R_Hip Spine1 L_Knee R_Knee Spine2 L_Ankle R_Ankle Spine3 L_Foot R_Foot Neck L_Collar R_Collar Head "
    "L_Shoulder R_Shoulder L_Elbow R_Elbow L_Wrist R_Wrist L_Hand R_Hand"
)
BONES = tuple(_BONES.split())
_SHAPES: dict[str, list[tuple[int, ...]]] = {"root_positions": [(3,)], "rotations": [(len(BONES), 4)]}
#: Ten minutes take about 40 MB.
MAX_BYTES = 1 << 28
_LOOKED_FOR = "NAME.json, in the source folder or in one folder of it, and NAME.wav"
#: Bound of the deviation of a quaternion's length from 1: files have a few decimals.
_TOLERANCE = 0.01
#: Unity's axes are left-handed, +X right: the mirror across x = 0 of positions, and of quaternions x y z w.
_MIRROR, _MIRROR_TURN = np.array([-1.0, 1.0, 1.0]), np.array([1.0, -1.0, -1.0, 1.0])

Floats = NDArray[np.float64]


@DATASETS.register("phantomdance")
@dataclass(frozen=True)
class PhantomDance(PairedDataset):
    """PhantomDance, from the published JSON and audio files.

    Attributes
    ----------
    split
        ``by-song``: a tenth of the dances is val, another is test, by a hash of their names; no split was published.
        ``all``: no split.
    """

    split: Literal["by-song", "all"] = field(default="by-song", metadata={"scan": True})

    body: ClassVar[Skeleton] = SMPL24_EDGE
    licence: ClassVar[str] = (
        "PhantomDance's repository: MIT (it links the data). Terms of the music are not stated: no redistribution."
    )
    citation: ClassVar[str] = (
        "Li et al., DanceFormer: Music Conditioned 3D Dance Generation with Parametric Motion Transformer, AAAI 2022."
    )
    layout: ClassVar[Layout] = Layout(
        "phantomdance", "PhantomDance", "", ".json", "NAME.json", published="version 1.2 has 260"
    )

    @override
    def find(self, source: Path) -> Listing:
        folder = self._folder(source)
        motions = files_by_stem(folder, source, ".json", lambda stem: "")
        places = [folder, source, *(entry for entry in list_folder(source) if entry.is_dir() and entry != folder)]
        places = list(dict.fromkeys(places))
        music = list_audio(places, source, lambda stem: "", places, self.music_dir)
        beside = [r for r in motions.rejects if not _is_beside(r.file, source, folder)]
        return Listing(Folders(source, folder, ()), replace(motions, rejects=tuple(beside)), music)

    @override
    def notes(self, listing: Listing, clips: Sequence[ClipRef]) -> Iterable[str]:
        yield "Axes: Unity's, left-handed: x is negated, and rotations in the world become relative to the parents."

    @override
    def load(self, ref: ClipRef) -> Motion:
        """Read a dance: 30 FPS, metres, right-handed with +Y up; the pelvis is at the translation (SMPL24_EDGE).

        Returns: Rotations (T, 24, 3) axis-angle relative to the parents, from the file's rotations in the world.
        Raises DataError: ``broken_file``, ``bad_skeleton``, ``bad_rotation``, ``bad_axes``, or as `read_frames`.
        """
        path, content = ref.motion_path, _content(ref.motion_path)
        order = _order(path, content["bone_name"])
        places, turns = read_frames(ValueArrays(path, content), _SHAPES)
        local = _local(path, turns.reshape(-1, len(BONES), 4)[:, order])
        motion = Motion(places * _MIRROR, local, FrameGrid.of(RATE), SMPL24_EDGE)
        require_upright(path, motion, "Unity's axes: +X right, +Y up, +Z forward; rotations in the world")
        return motion

    @override
    def make_example(self, folder: Path) -> None:
        """Write three dances of six seconds and their music."""
        from dancedata.datasets._examples import dance, write_json, write_song

        for name, steps, n in (
            ("dance_001", "gBR_sBM_cAll_d04_mBR0_ch01", 181),
            ("dance_002", "gPO_sBM_cAll_d10_mPO4_ch03", 180),
            ("dance_003", "gMH_sBM_cAll_d22_mMH1_ch04", 186),
        ):
            write_json(folder / "motion" / f"{name}.json", content_of(dance(steps, n)))
            write_song(folder / "music" / f"{name}.wav", steps, n / RATE, 16_000)

    def _folder(self, source: Path) -> Path:
        require_folder(self.name, source, _LOOKED_FOR)
        below = [source, *(entry for entry in list_folder(source) if entry.is_dir())]
        folders = [folder for folder in below if _has_motions(folder)]
        if len(folders) == 1:
            return folders[0]
        if folders:
            raise SourceError("phantomdance: several folders have JSON files", where=str(source),
                              found=listed(relative(folder, source) for folder in folders),
                              fix="set SOURCE to the folder of motions, and music_dir to that of music")  # fmt: skip
        raise SourceError("phantomdance: no motion found", where=str(source), found=describe(source),
                          allowed=_LOOKED_FOR, fix="set SOURCE to the folder of the unpacked archive")  # fmt: skip


def _has_motions(folder: Path) -> bool:
    return any(path.suffix.lower() == ".json" and path.is_file() for path in list_folder(folder))


def _is_beside(file: str, source: Path, folder: Path) -> bool:
    """Return whether an entry beside the motions is music, or a folder of the source."""
    return PurePath(file).suffix.lower() in AUDIO_SUFFIXES or (folder == source and file.endswith("/"))


def _content(path: Path) -> dict[str, Any]:
    try:
        content = read_json(path, MAX_BYTES)
    except (OSError, ValueError) as error:
        raise DataError("the motion file cannot be read", reason="broken_file", where=str(path), found=str(error),
                        allowed=f"JSON of at most {MAX_BYTES:,} bytes", fix=DOWNLOAD_AGAIN) from error  # fmt: skip
    content = content if isinstance(content, dict) else {}
    if "name" in content:
        content.setdefault("bone_name", content["name"])  # of the first release
    require_keys(ValueArrays(path, content), ("bone_name", *_SHAPES))
    for key in _SHAPES:
        try:
            content[key] = np.asarray(content[key], dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            held = "lists of different lengths, or something other than numbers"
            raise bad_shape(path, key, held, "numbers") from None
    return content


def _order(path: Path, names: Any) -> list[int]:
    bones = [name for name in names if isinstance(name, str)] if isinstance(names, list) else []
    if len(bones) != len(BONES) or set(bones) != set(BONES):
        raise DataError("the bones are not those of SMPL", reason="bad_skeleton", where=str(path),
                        found=listed(bones, show=quoted) or type(names).__name__,
                        allowed=f"{len(BONES)} names: {', '.join(BONES[:4])}, ...", fix=DOWNLOAD_AGAIN)  # fmt: skip
    return [bones.index(name) for name in BONES]


def _local(path: Path, turns: Floats) -> Floats:
    """Return axis-angle relative to the parents (T, 24, 3) of quaternions in the world (T, 24, 4), x y z w."""
    from scipy.spatial.transform import Rotation

    off = np.abs(np.linalg.norm(turns, axis=-1) - 1)
    if off.max() > _TOLERANCE:
        frame, joint = (int(k) for k in np.argwhere(off > _TOLERANCE)[0])
        raise DataError("not a quaternion of length 1", reason="bad_rotation",
                        where=f"{path}, frame {frame}, {BONES[joint]}",
                        found=f"({', '.join(f'{x:.4g}' for x in turns[frame, joint])})",
                        allowed=f"x y z w, of length 1 within {_TOLERANCE:g}", fix=DOWNLOAD_AGAIN)  # fmt: skip
    world = Rotation.from_quat((turns * _MIRROR_TURN).reshape(-1, 4)).as_matrix().reshape(*turns.shape[:2], 3, 3)
    local = world.copy()
    for joint in range(1, len(BONES)):
        local[:, joint] = np.swapaxes(world[:, SMPL24_EDGE.parents[joint]], -1, -2) @ world[:, joint]
    return rotvec_from_matrix(local)


def content_of(motion: Motion) -> dict[str, Any]:
    """Return a motion on SMPL's joints as a file of PhantomDance has it."""
    from scipy.spatial.transform import Rotation

    world = world_matrices(motion.skeleton, motion.matrices)
    turns = Rotation.from_matrix(world.reshape(-1, 3, 3)).as_quat().reshape(*world.shape[:2], 4) * _MIRROR_TURN
    places = motion.joints()[:, 0] * _MIRROR
    return {
        "bone_name": list(BONES),
        "root_positions": np.round(places, 6).tolist(),
        "rotations": np.round(turns, 6).tolist(),
    }
