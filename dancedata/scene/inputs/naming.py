"""What the names of motion refer to, a dataset's samples or songs; with its music, from the right second on."""

import glob
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path

from dancedata.core.errors import DataError, UsageError
from dancedata.core.sample_id import SampleId
from dancedata.core.text import counted, listed, shown
from dancedata.formats.aist_names import parse_name, tempo_bpm
from dancedata.formats.values import MOTION_SUFFIXES
from dancedata.kernel import Sample, Store
from dancedata.samples import Samples
from dancedata.scene.inputs.clip import ClipInput
from dancedata.scene.inputs.songs import MusicSources, Song, of_known
from dancedata.store.dataset_json import INTERRUPTED, describe_folder


@dataclass(frozen=True, eq=False)
class Named:
    """Clips with the names, tempos and seconds of their music."""

    clips: tuple[ClipInput, ...]
    samples: Mapping[str, Sample] = field(default_factory=dict)  # those that are samples of a dataset, by id
    # `by_song`, `unknown`: ids of clips of which only the song is known, and of those about which nothing is known
    by_song: tuple[str, ...] = ()
    unknown: tuple[str, ...] = ()

    def found(self, name: str, like: Store) -> str:
        """Return what was found in a folder or file, in words: the first line of every command."""
        n, clips = len(self.clips), {of.clip.id for of in self.samples.values()}
        splits = listed(sorted({of.clip.split for of in self.samples.values()}))
        windows = sum(of.id.start is not None for of in self.samples.values())
        what = counted(len(clips), "clip")
        what = f"{counted(len(self.samples), 'window')} of {what}" if windows else what
        sources = sorted({of.id.source for of in self.samples.values()})
        mixed = f", from its sources {listed(sources)} together" if len(sources) > 1 else ""
        parts = [f"{what} of {like.path.name} ({splits}){mixed}"] if self.samples else []
        at_begin = not any(clip.audio_start for clip in self.clips if clip.id in self.by_song)
        second = "its second 0" if at_begin else "the second that the list of songs names"
        parts += [f"{len(self.by_song)} by song, from {second}"] if self.by_song else []
        parts += [f"{len(self.unknown)} without a clip or song: {listed(self.unknown)}"] if self.unknown else []
        return f"{name}: {counted(n, 'sample')}: {', '.join(parts)}"

    def nothing_matched(self, where: str, like: Store) -> DataError | None:
        """Return the error for files of which nothing is known: neither their music nor their truth."""
        if len(self.unknown) < len(self.clips) or all(clip.file is None for clip in self.clips):
            return None
        example = like.clips()[0].id
        return DataError(
            f"none of {counted(len(self.clips), 'file')} is named after a clip, window or song of {like.path.name}",
            reason="nothing_matched", where=where, found=listed(self.unknown),
            allowed=f"CLIP or CLIP@START+LENGTH, such as {example} and {SampleId(example, 0, 150)}",
            fix="write samples with save_samples; or name their songs in a list, music=FILE.csv; or choose metrics "
            "without music", options="write samples with save_samples; or name their songs in a list, --music "
            "FILE.csv; or choose metrics without music",
        )  # fmt: skip


def named_clips(clips: Sequence[ClipInput], sources: MusicSources, like: Store | None) -> Named:
    """Find out which clips of a dataset motion belongs to, and which music: every command uses this function.

    The entry ``id`` of a file, or else its name, names the sample of `like`: with its music, from the right second
    on. The song is from the sources, the clip itself, the sample, or the name, which then is that of a song or
    has AIST++'s form; such a clip begins with the song. The tempo is that of this song.

    Raises DataError: "two_ids" and "two_samples" for names that conflict; "no_clip", "outside" for windows that
        the dataset does not have.
    Raises UsageError: for a window whose song is named without the second, or that dances to another one.
    """
    finder = None if like is None else Samples(like)
    song_names = frozenset(sources.files) | {c.music for c in (() if like is None else like.clips()) if c.music}
    songs = of_known(sources.songs, song_names | {clip.music for clip in clips})
    tempos = {} if like is None else {c.music: c.tempo_bpm for c in like.clips() if c.music and c.tempo_bpm}
    named: list[ClipInput] = []
    samples: dict[str, Sample] = {}
    by_song: list[str] = []
    unknown: list[str] = []
    for clip in clips:
        sample = None if finder is None or clip.stored else _sample(finder, clip)
        song, name = songs.get(clip.id), parse_name(clip.id)
        if song is None and sources.song:
            song = _song_of_all(sources.song, sample)
        record = None if sample is None else sample.clip
        guesses = (
            clip.id if clip.id in song_names else "",
            name.music if name else "",
            _song_within(clip.id, song_names),
        )
        names = (song, clip.music, record and record.music, *guesses)
        music = next((text for text in names if text), "")
        same = [c for c in (clip, record) if c is not None and song in (None, c.music)]
        tempo = next((c.tempo_bpm for c in same if c.tempo_bpm), None) or tempos.get(music) or tempo_bpm(music)
        start = _begin(clip, sample, song, music)
        if sample is not None:
            _require_all_dancers(clip, sample)
            samples[clip.id] = sample
            clip = of_sample(clip, sample)
        elif not clip.stored:
            (by_song if music else unknown).append(clip.id)
            clip = replace(clip, recording=f"song:{music}" if music and name is None else "")
        named.append(replace(clip, music=music, tempo_bpm=tempo, audio_start=start))
    _require_one_each(samples)
    return Named(tuple(named), samples, tuple(by_song), tuple(unknown))


def _require_all_dancers(clip: ClipInput, sample: Sample) -> None:
    """Raise UsageError if the files of a group's dancers, named by ids, do not cover all of them."""
    files = clip.dancer_files
    if files and len(files) < len(sample.clips) and all(SampleId.parse(f.stem).dancer is not None for f in files):
        raise UsageError("not all dancers of a group are here", reason="group_dancer", where=clip.id,
                         found=listed([f.stem for f in files]),
                         allowed=listed([f"{clip.id}~p{dancer.member}" for dancer in sample.clips]),
                         fix="write all of them, or choose a protocol for single dancers")  # fmt: skip


def of_sample(clip: ClipInput, sample: Sample) -> ClipInput:
    """Return a clip with what is known of it as a sample."""
    length = None if sample.id.start is None else sample.store.grid.seconds(sample.length)
    return replace(clip, audio_start=sample.music_start_s, recording=sample.recording, length_s=length)


def _sample(finder: Samples, clip: ClipInput) -> Sample | None:
    """Return the sample of a dataset that the entry ``id`` of a file, or else its name, names."""
    of_name = finder.find(clip.id)
    if not clip.stated_id:
        if of_name is None and SampleId.parse(clip.id).start is not None:
            finder.require(clip.id)
        return of_name
    sample = finder.find(clip.stated_id)
    if of_name is not None and sample is not None and of_name.id != sample.id:
        raise DataError("a file has two ids", reason="two_ids", where=str(clip.file),
                        found=f"{sample.id} in it, {of_name.id} as its name", fix="rename it")  # fmt: skip
    return sample or of_name


def _require_one_each(samples: Mapping[str, Sample]) -> None:
    """Raise DataError "two_samples" if two files have one id."""
    ids: dict[SampleId, str] = {}
    for name, sample in samples.items():
        if ids.setdefault(sample.id, name) != name:
            both = listed([ids[sample.id], name])
            raise DataError(f"two samples are {sample.id}", reason="two_samples", found=both,
                            fix=f"number them: {replace(sample.id, take=1)}")  # fmt: skip


def _begin(clip: ClipInput, sample: Sample | None, song: Song | None, music: str) -> Fraction:
    """Return the second of its song at a clip's first frame."""
    if song is not None and song.start is not None:
        return song.start
    if clip.stored:
        return clip.audio_start if song in (None, clip.music) else Fraction(0)
    is_window = (SampleId.parse(clip.id) if sample is None else sample.id).start is not None
    begin = Fraction(0) if sample is None else sample.music_start_s
    if sample is not None and (song is None or (not is_window and song == sample.clip.music)):
        return begin
    if not is_window or not music or (sample is not None and not begin):
        return Fraction(0)
    right = "SECONDS" if sample is None else f"{float(begin):.9g}"
    raise UsageError(
        "a song is named for a window, but not the second at which the window begins in it; 0 would be the beginning "
        "of the song", reason="no_start", where=clip.id, found=f"{shown(music)} without start_s",
        allowed="the second that the dataset of the window has: name that dataset (like)" if sample is None
        else f"second {right}, at which the window begins in its music",
        fix=f"write a line {clip.id},{shown(music)},{right} (sample,song,start_s)",
    )  # fmt: skip


def _song_of_all(song: str, sample: Sample | None) -> Song:
    """Return the song of all clips, for a window from its second on; UsageError if that has other music."""
    if sample is None or sample.id.start is None:
        return Song.of(song)
    if sample.clip.music not in ("", song):
        raise UsageError(
            "a song is named for a window whose music the dataset has", reason="music_twice", where=str(sample.id),
            found=song,
            allowed=f"{sample.clip.music}, from its second {float(sample.music_start_s):g}",
            fix=f"leave the music out; for other music on purpose write a list: {sample.id},{song},SECONDS "
            "(sample,song,start_s)",
        )  # fmt: skip
    return Song.of(song, sample.music_start_s)


def _song_within(name: str, songs: frozenset[str]) -> str:
    """Return the one song that is a part of a name between underscores, as in gBR_sBM_cAll_d04_mBR0_ch01."""
    parts = songs.intersection(name.split("_"))
    return next(iter(parts)) if len(parts) == 1 else ""


def motion_paths(path: Path) -> list[Path]:
    """Return the motion files of a folder or a pattern by name, or one file as it is; empty if there are none."""
    if path.is_file():
        return [path]
    entries = path.iterdir() if path.is_dir() else map(Path, glob.glob(str(path)))
    return sorted(p for p in entries if p.suffix.lower() in MOTION_SUFFIXES and p.is_file())


def motion_files(path: Path, purpose: str) -> list[Path]:
    """Return the motion files of a folder or a pattern, or one file, for every command that takes motion."""
    files = motion_paths(path)
    if not files or not all(file.suffix.lower() in MOTION_SUFFIXES for file in files):
        content = describe_folder(path) if path.is_dir() else f"a file {path.suffix}"
        raise DataError(
            f"there is nothing to {purpose}", reason="nothing_matched", where=path,
            found=content if path.exists() else "no such file or folder",
            allowed=f"a built dataset, a folder of motion files, or a file {', '.join(MOTION_SUFFIXES)}",
            fix=INTERRUPTED if content == "an empty folder" or "an unfinished build" in content else None,
        )  # fmt: skip
    require_unique([file.stem for file in files], path)
    return files


def require_unique(names: Sequence[str], where: Path) -> None:
    """Raise UsageError for two motions of one name."""
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise UsageError(
            "two files have the same name", where=where, found=listed(twice, 5), fix="rename one of them"
        )
