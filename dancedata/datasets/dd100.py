"""DD100 (Siyao et al. 2024, Duolando): 100 minutes of duets in ten genres with hands, 30 FPS, +Z up.

The files: docs/datasets/dd100.md; ``poses`` may also be (T, 55, 3), and files lie in train/ and test/ as well.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np

from dancedata.core.bodies import SMPLX55, transfer_to
from dancedata.core.clip import ClipRef, Reject
from dancedata.core.errors import DataError, SourceError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.registry import DATASETS
from dancedata.core.rotations import matrix_from_rotvec, rotvec_from_matrix
from dancedata.core.skeleton import Skeleton
from dancedata.core.text import counted
from dancedata.core.typing import override
from dancedata.datasets.checks import DOWNLOAD_AGAIN, read_frames, require_rotations, spine_of, up_axis, upright
from dancedata.datasets.files import Files, describe, extra_file, files_by_stem, list_audio, relative, with_music_dir
from dancedata.datasets.published import OFFICIAL, Layout, Listing, PairedDataset, Splits
from dancedata.formats.stated import UPRIGHT
from dancedata.formats.values import ValueArrays, load_object

RATE, JOINTS = 30, SMPLX55.n_joints
_SHAPES: dict[str, list[tuple[int, ...]]] = {
    "poses": [(3 * JOINTS,), (JOINTS, 3)],
    "global_orient": [(3,)],
    "transl": [(3,)],
}
#: Largest difference between entries of the root's two rotation matrices.
_SAME_ROOT = 1e-3
ROLES = ("follower", "leader")
#: Duolando's script copies the files of all/ to train/ and test/.
_PARTS = ("all", "train", "test")
_MOTION, _MUSIC = "motion/smplx", "music/mp3"
# Explicit ranges: \d would accept digits of other scripts.
_PAIR = re.compile(r"([A-Za-z]+)_([0-9]+)_([0-9]+)")
_DANCER = re.compile(rf"({_PAIR.pattern})_0([01])")


def _dancer_problem(stem: str) -> str:
    return "" if _DANCER.fullmatch(stem) else "not named GENRE_CHOREO_TAKE_00 (follower) or _01 (leader)"


def _pair_problem(stem: str) -> str:
    return "" if _PAIR.fullmatch(stem) else "not named GENRE_CHOREO_TAKE"


def is_test(pair: str) -> bool:
    """Return whether Duolando's script puts a pair into test."""
    genre, choreography, _ = pair.rsplit("_", 2)
    number = int(choreography)
    return number in (9, 10) if genre == "Ballet" else number % 5 == 0


@DATASETS.register("dd100")
@dataclass(frozen=True)
class DD100(PairedDataset):
    """DD100, from the published files: each clip is one dancer, each pair a group of follower and leader.

    Attributes
    ----------
    split
        ``official``: the rule of Duolando's script, which keeps the takes of a choreography together; no val.
        ``by-choreography``: a tenth of the choreographies each is val and test, by a hash of their names.
    up
        Axis that is up in the files: ``z`` as published, or ``y``. A file whose heads are elsewhere is set aside.
    """

    split: Literal["official", "by-choreography"] = field(default="official", metadata={"scan": True})
    up: Literal["z", "y"] = "z"

    body: ClassVar[Skeleton] = SMPLX55
    licence: ClassVar[str] = (
        "S-Lab License 1.0 (Duolando's repository): non-commercial use only; ask the authors about redistribution."
    )
    citation: ClassVar[str] = (
        "Siyao et al., Duolando: Follower GPT with Off-Policy Reinforcement Learning for Dance Accompaniment, "
        "ICLR 2024."
    )

    layout: ClassVar[Layout] = Layout(
        "dd100", "DD100", _MOTION, ".npy", "all/GENRE_CHOREO_TAKE_00.npy and _01.npy", folder_names=("dd100",)
    )
    unit: ClassVar[str] = "choreography"

    @override
    def find(self, source: Path) -> Listing:
        """List the files of the dancers; those of a pair are one motion, its first file."""
        folders = self.layout.find(source)
        parts = [(folders.root / _MOTION / part, folders.root / _MUSIC / part) for part in _PARTS]
        dancers = _merged([files_by_stem(motion, source, ".npy", _dancer_problem) for motion, _ in parts], source)
        if not dancers.files:
            raise SourceError("dd100: no motion found", where=str(folders.root / _MOTION),
                              found=describe(folders.root / _MOTION), allowed=self.layout.expected,
                              fix="check that the archive was unpacked completely")  # fmt: skip
        audio = _merged([list_audio([music], source, _pair_problem) for _, music in parts], source)
        pairs = {stem.rsplit("_", 1)[0]: path for stem, path in sorted(dancers.files.items(), reverse=True)}
        absent = [
            Reject("missing_partner", clip=f"{pair}_0{member}", file=relative(path, source),
                   detail=f"there is no {pair}_0{member}.npy, the {role}")
            for pair, path in sorted(pairs.items())
            for member, role in enumerate(ROLES)
            if f"{pair}_0{member}" not in dancers.files
        ]  # fmt: skip
        motions = Files(pairs, tuple(absent))
        music = with_music_dir(audio, self.music_dir, source, _pair_problem)
        return Listing(folders, motions, music, dancers)

    @override
    def unit_of(self, name: str) -> str:
        return name.rsplit("_", 1)[0]

    @override
    def splits(self, listing: Listing) -> Splits:
        pairs = listing.motions.files
        lists = {split: [pair for pair in pairs if is_test(pair) == (split == "test")] for split in ("train", "test")}
        if self.split != OFFICIAL:
            return replace(super().splits(listing), lists=lists)
        rule = "official: choreographies whose number is a multiple of five, and Ballet 9 and 10, are test; no val."
        return Splits({pair: "test" if is_test(pair) else "train" for pair in pairs}, (f"Splits: {rule}",), lists)

    @override
    def clips_of(self, ref: ClipRef, listing: Listing) -> Iterable[ClipRef]:
        for member, role in enumerate(ROLES):
            path = listing.beside.files.get(f"{ref.id}_0{member}")
            if path is not None:
                yield replace(
                    ref, id=path.stem, motion_path=path, genre=ref.id.split("_")[0], group=ref.id, member=member,
                    group_size=len(ROLES), role=role,
                )  # fmt: skip

    @override
    def layout_notes(self, listing: Listing) -> Iterable[str]:
        n, n_songs = counted(len(listing.beside.files), "file"), counted(len(listing.music.files), "audio file")
        yield f"Layout: DD100, by {_MOTION}/ ({n}); {n_songs}."

    @override
    def notes(self, listing: Listing, clips: Sequence[ClipRef]) -> Iterable[str]:
        yield (
            f"Axes: +{self.up.upper()} up, {'turned to +Y; ' if self.up == 'z' else ''}partners share one world; "
            f"metres, {RATE} FPS. Heads are compared with pelvises as files are read. Betas are not used."
        )

    @override
    def load(self, ref: ClipRef) -> Motion:
        """Read one dancer: 30 FPS, metres, SMPLX55, turned to +Y up about the origin of the partners' world.

        DataError: as `load_object` and `read_frames`, ``not_rotations``, ``bad_axes``;
        ``contradiction`` if the root's two rotations differ.
        """
        path = ref.motion_path
        poses, root, places = read_frames(ValueArrays(path, load_object(path)), _SHAPES)
        rotations = poses.reshape(-1, JOINTS, 3)
        require_rotations(path, "poses", rotations, places, SMPLX55.parents)
        off = np.abs(matrix_from_rotvec(rotations[:, 0]) - matrix_from_rotvec(root)).max(axis=(1, 2))
        if off.max() > _SAME_ROOT:
            frame = int((off > _SAME_ROOT).argmax())
            stated = f"poses {rotations[frame, 0].round(4).tolist()}, global_orient {root[frame].round(4).tolist()}"
            raise DataError("the root's rotation is in the file twice, and they differ", reason="contradiction",
                            where=f"{path}, frame {frame}", found=stated, fix=DOWNLOAD_AGAIN)  # fmt: skip
        motion = Motion(places, rotations, FrameGrid.of(RATE), SMPLX55)
        return upright(motion, up_axis(path, spine_of(motion), self.up, self.name))

    @override
    def make_example(self, folder: Path) -> None:
        """Write three pairs of eight seconds: two of test, one of train; leaders are float32, 3 frames shorter."""
        from dancedata.datasets._examples import dance, write_array, write_song

        for name, n, steps in (
            ("Ballet_9_0", 246, "gLH_sBM_cAll_d16_mLH1_ch01"),
            ("Waltz_5_0", 249, "gJS_sFM_cAll_d01_mJS1_ch02"),
            ("Waltz_6_0", 253, "gHO_sBM_cAll_d19_mHO3_ch01"),
        ):
            write_song(folder / _MUSIC / "all" / f"{name}.wav", steps, n / RATE)
            motion = transfer_to(dance(steps, n), SMPLX55)
            for member, length, kind in ((0, n, np.float64), (1, n - 3, np.float32)):
                arrays = content_of(motion.part(0, length), facing=member == 1)
                content = {key: array.astype(kind) for key, array in arrays.items()}
                content["meta"] = {"gender": ("female", "male")[member]}
                write_array(folder / _MOTION / "all" / f"{name}_0{member}.npy", content)


def _merged(parts: list[Files], source: Path) -> Files:
    """Join the files of all/, train/ and test/: of several with one name the first is read."""
    files: dict[str, Path] = {}
    rejects = [reject for part in parts for reject in part.rejects]
    for part in parts:
        for name, path in part.files.items():
            if files.setdefault(name, path) != path:
                rejects.append(extra_file(path, source, f"the same name as {relative(files[name], source)}"))
    return Files(files, tuple(rejects), tuple(note for part in parts for note in part.notes))


def content_of(motion: Motion, *, facing: bool) -> dict[str, Any]:
    """Return a dancer on SMPL-X as a file of DD100 has it, +Z up; `facing`: turned round, opposite the partner."""
    turn = np.diag([-1.0, 1.0, -1.0]) if facing else np.eye(3)
    world, pelvis = UPRIGHT["z"].T @ turn, SMPLX55.offsets[0]
    rotations = motion.rotations.copy()
    rotations[:, 0] = rotvec_from_matrix(world @ motion.matrices[:, 0])
    rotations[:, 25:40, 2] -= 0.3
    rotations[:, 40:55, 2] += 0.3
    place = motion.translation + pelvis + (0.0, 0.0, -0.45)
    return {
        "poses": rotations.reshape(len(rotations), -1),
        "global_orient": rotations[:, 0],
        "transl": place @ world.T - pelvis,
        "betas": np.full((len(rotations), 10), 0.1),
    }
