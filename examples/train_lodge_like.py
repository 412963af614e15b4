"""A small global stage of Lodge (Li et al., CVPR 2024): music and genre become the primitives of a long dance.

    dancedata build demo --out data/primitives --set motion='{lodge139: {}}' --set keymotion='{lodge: {}}'
    python examples/train_lodge_like.py --data data/primitives --out runs/lodge     # a minute on a CPU
    accelerate launch examples/train_lodge_like.py --data data/finedance --out runs/lodge --frames 1024 --segment 256

`--data` is FineDance (`dancedata build finedance`), AIST++ (`dancedata build aist++-lodge`), or the demo as above.
A window of four segments has 13 primitives of 8 frames: diffusion makes all of them at once, from the music around
each and the genre. OUT/dance.bvh and OUT/dance.svg have the generated primitives, with straight lines between them
(the task of Lodge's local stage); OUT/primitives.npz has them unchanged. Training, resuming and diffusion are those
of train_edge_like.py, and it needs accelerate, too: pip install accelerate.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn
from train_edge_like import Denoiser, Losses, options, sample, train, write_dance

import dancedata
from dancedata.core.errors import DanceDataError
from dancedata.core.rotations import slerp
from dancedata.keymotion import primitives
from dancedata.torch import Primitives, Scale, WindowDataset, Windows
from dancedata.torch.kinematics import Poses, decode, matrix_from_rotvec

FIELD, CUE, CONTEXT = "lodge139", 8, 32


class GlobalDenoiser(nn.Module):
    """Returns clean primitives (B, K, 8, D) of noisy ones; conditions: music (B, T, M), frames (B, K), genre (B,)."""

    def __init__(self, motion: int, music: int, genres: int, width: int, layers: int, frames: int) -> None:
        super().__init__()
        self.frames, self.genre = frames, nn.Embedding(genres + 1, width)
        self.moment = nn.Sequential(nn.Linear(1, width), nn.SiLU(), nn.Linear(width, width))
        # A primitive is a token; its condition is the music within CONTEXT frames.
        self.tokens = Denoiser(CUE * motion, width, width, layers, 2 * frames // CUE)
        self.listen = nn.Conv1d(music, width, 2 * CONTEXT + 1, padding=CONTEXT)

    def forward(
        self, noisy: Tensor, level: Tensor, music: Tensor, start: Tensor, genre: Tensor, keep: Tensor
    ) -> Tensor:
        """Genre -1 is unknown; music and genre are left out where `keep` (B,) is false."""
        heard = self.listen(music.transpose(1, 2)).transpose(1, 2)
        middle = (start + CUE // 2)[..., None]
        heard = heard.gather(1, middle.expand(-1, -1, heard.shape[-1]))
        condition = heard + self.genre(genre + 1)[:, None] + self.moment(middle / self.frames)
        return self.tokens(noisy.flatten(2), level, condition, keep).view_as(noisy)


def placed_on_beats(data: WindowDataset, music: np.ndarray, segment: int) -> np.ndarray:
    """Return the first frames of primitives for music (T, 35): hard cues at borders, soft cues on beats near by."""
    nothing = np.zeros((len(music), data.store.fields[FIELD].width), np.float32)
    cues = primitives(nothing, len(music), segment, minima=np.empty(0, int), prominence=np.empty(0))
    beats = np.flatnonzero(music[:, data.store.fields["librosa35"].slice("beat")][:, 0]) - CUE // 2
    start = cues.start.copy()
    for k in np.flatnonzero(~cues.hard):
        near = beats[(beats >= start[k - 1] + CUE) & (beats <= start[k + 1] - CUE) & (abs(beats - start[k]) <= 12)]
        start[k] = min(near, key=lambda beat, k=k: abs(beat - start[k]), default=start[k])
    return start


def connected(cues: Poses, start: np.ndarray, frames: int) -> Poses:
    """Return a dance of all frames: the cues, and straight lines between them."""
    known = (start[:, None] + np.arange(CUE)).ravel()
    known, first = np.unique(known, return_index=True)
    at = np.interp(np.arange(frames), known, np.arange(len(known)))
    turns = cues.rotations().flatten(0, 1).double().cpu().numpy()[first]
    root = cues.translation.flatten(0, 1).double().cpu().numpy()[first]
    root = np.stack([np.interp(at, np.arange(len(root)), axis) for axis in root.T], axis=-1)
    return Poses(cues.skeleton, torch.from_numpy(root), matrix_from_rotvec(torch.from_numpy(slerp(turns, at))))


def main() -> None:
    """Train, and generate."""
    parser = options(__doc__, frames=256, segment=64, batch=32)
    parser.add_argument("--genre", help="genre to generate; default: that of the dataset's last clip")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    store = dancedata.open(args.data)
    genres = sorted({clip.genre for clip in store if clip.genre})
    data = WindowDataset(
        store,
        fields=(FIELD, "librosa35", Primitives(n=args.segment)),
        windows=Windows(length=args.frames, stride=max(1, args.frames // 10), trim=True),
        scale=Scale(fields=(FIELD, "librosa35")),
        augment={"mirror": 0.5},
    )
    model = GlobalDenoiser(store.fields[FIELD].width, 35, len(genres), args.width, args.layers, args.frames)

    def condition_of(batch: dict) -> tuple[Tensor, Tensor, Tensor]:
        genre = [genres.index(name) if name else -1 for name in batch["genre"]]
        return batch["librosa35"], batch["primitive_start"], torch.tensor(genre)

    music = store.clips()[-1].read("librosa35")
    if args.song:
        music = dancedata.features(args.song, "librosa35", fps=store.fps)
    if len(music) < args.frames:
        raise SystemExit(f"the music has {len(music)} frames; --frames {args.frames} are needed")
    accelerator, model = train(args, model, data, Losses(data, FIELD), condition_of, "primitives")
    if not accelerator.is_main_process:
        return
    music = music[: args.frames]
    start = placed_on_beats(data, music, args.segment)
    genre = args.genre or store.clips()[-1].genre
    heard = torch.from_numpy(data.scaler("librosa35").normalize(music))[None]
    condition = (heard, torch.from_numpy(start)[None], torch.tensor([genres.index(genre) if genre else -1]))
    condition = tuple(value.to(accelerator.device) for value in condition)
    model.eval()
    shape = (1, len(start), CUE, store.fields[FIELD].width)
    made = sample(model, shape, condition, args.ddim, args.guidance, lambda x: x)[0]
    columns = data.scaler(FIELD).unnormalize(made)
    np.savez(args.out / "primitives.npz", frames=columns.cpu().numpy(), start=start, genre=genre)
    write_dance(args.out / "dance", connected(decode(columns, FIELD), start, args.frames), float(store.fps))


if __name__ == "__main__":
    try:
        main()
    except DanceDataError as error:
        raise SystemExit(f"error: {error}") from None
