"""Makes the weights and the reference outputs of the feature beats, and compares with the package beat_this.

The weights are of a small network in the layout of the published ones. It is trained here on the synthetic music, so
that they may be passed on and find beats::

    python tests/golden/against_beat_this.py train

The reference outputs are those of the package (MIT). It needs torchaudio, whose releases trail those of torch, so an
environment of its own may be needed: ``pip install beat_this torchaudio`` beside dancedata. Without ``--write`` the
outputs are only compared::

    python tests/golden/against_beat_this.py compare [--write] [--weights final0.ckpt]
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import load_file, save_file

from dancedata.audio.beats.by_network import beats_of, log_mel, song_logits
from dancedata.audio.beats.network import BeatNetwork, Sizes
from dancedata.audio.beats.weights import load_network
from dancedata.music.samples import resample
from dancedata.synthetic import synthesise_song
from dancedata.synthetic.plan import CATALOGUE

TESTS = Path(__file__).parents[1]
WEIGHTS = TESTS / "audio" / "data" / "beat_this_tiny.safetensors"
REFERENCE = TESTS / "golden" / "data" / "beat_this" / "reference.npz"
SIZES = Sizes(stem=8, width=32, inner=64, layers=2, head=8)
#: What the package calls them.
HYPER_PARAMETERS = {
    "spect_dim": 128, "stem_dim": 8, "transformer_dim": 32, "ff_mult": 2, "n_layers": 2, "head_dim": 8,
    "sum_head": True, "partial_transformers": True,
}  # fmt: skip
#: Longer than a stretch of the network.
SONG, SONG_S = "mLO3", 34.0
#: Frames of the spectrum that are kept.
KEPT = slice(100, 200)


def spectrum_of(song: str, length_s: float, seed: int = 0) -> tuple[torch.Tensor, np.ndarray, np.ndarray]:
    """The spectrum of a synthetic song, its beats and its downbeats in seconds."""
    made = synthesise_song(song, length_s=length_s, seed=seed)
    samples = resample(made.signal.samples, made.signal.sample_rate, 22050)
    return log_mel(torch.from_numpy(samples.copy())), made.beat_times_s, made.downbeat_times_s


def train(steps: int = 900) -> None:
    """Train the small network on songs of another seed than those of the tests; half precision is enough."""
    torch.manual_seed(0)
    rng = np.random.default_rng(0)
    songs = [_example(f"m{music}", seed) for seed, music in enumerate(CATALOGUE[:30], start=1)]
    network = BeatNetwork(SIZES).train()
    optimizer = torch.optim.AdamW(network.parameters(), lr=3e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 6e-3, total_steps=steps)
    weight = torch.tensor([5.0, 12.0])
    for step in range(steps):
        spectrum, target = songs[int(rng.integers(len(songs)))]
        first = int(rng.integers(len(spectrum) - 300))
        part, wanted = spectrum[first : first + 300], target[first : first + 300]
        loss = torch.nn.functional.binary_cross_entropy_with_logits(network(part), wanted, pos_weight=weight)
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
        schedule.step()
        if step % 100 == 99:
            print(step + 1, round(loss.item(), 4), flush=True)
    state = {
        name: value.half() if value.is_floating_point() else value for name, value in network.state_dict().items()
    }
    save_file({name: value.contiguous() for name, value in state.items()}, WEIGHTS)


def _example(song: str, seed: int) -> tuple[torch.Tensor, torch.Tensor]:
    spectrum, *times = spectrum_of(song, 13.0, seed)
    target = torch.zeros(len(spectrum), 2)
    for column, seconds in enumerate(times):
        frames = torch.from_numpy(np.rint(seconds * 50).astype(np.int64))
        for shift, value in ((-1, 0.25), (1, 0.25), (0, 1.0)):
            target[(frames + shift).clamp(0, len(target) - 1), column] = value
    return spectrum, target


def compare(weights: Path, write: bool) -> None:
    """Compare spectrum, logits and beats with the package's; write the package's if asked to."""
    from beat_this.inference import Spect2Frames
    from beat_this.model.postprocessor import Postprocessor
    from beat_this.preprocessing import LogMelSpect

    made = synthesise_song(SONG, length_s=SONG_S)
    samples = torch.from_numpy(resample(made.signal.samples, made.signal.sample_rate, 22050).copy())
    with tempfile.TemporaryDirectory() as folder, torch.inference_mode():
        checkpoint = Path(folder) / "network.ckpt"
        if weights.suffix == ".safetensors":
            state = {f"model.{name}": value.float() for name, value in load_file(weights).items()}
            torch.save({"state_dict": state, "hyper_parameters": HYPER_PARAMETERS}, checkpoint)
        else:
            checkpoint = weights.absolute()
        theirs = LogMelSpect()(samples)
        logits = torch.stack(Spect2Frames(str(checkpoint))(theirs), dim=1)
        beats, downbeats = Postprocessor()(logits[:, 0], logits[:, 1])
        spectrum = log_mel(samples)
        own = song_logits(load_network(weights), spectrum)
    track = beats_of(own.numpy())
    print("log-mel, largest difference:", float((theirs - spectrum).abs().max()))
    print("logits, largest difference:", float((logits - own).abs().max()))
    frames = track.frames
    same = [
        np.array_equal(np.rint(found * 100), kept)
        for found, kept in ((beats, frames), (downbeats, frames[track.downbeats]))
    ]
    print("beats and downbeats are equal:", *same, f"({len(beats)}, {len(downbeats)})")
    if write:
        np.savez_compressed(
            REFERENCE, log_mel=theirs[KEPT].numpy(), logits=logits.numpy(), beats=beats, downbeats=downbeats
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("what", choices=["train", "compare"])
    parser.add_argument("--write", action="store_true", help="replace reference.npz")
    parser.add_argument("--weights", type=Path, default=WEIGHTS, help="other weights, such as final0.ckpt")
    given = parser.parse_args()
    torch.set_num_threads(1)
    train() if given.what == "train" else compare(given.weights, given.write)
