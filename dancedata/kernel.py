"""The public names of the kernel above core and files."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dancedata.core.lazy import lazy_names

__all__ = [
    "CLIP_COLUMNS",
    "DATASET_FILE",
    "AlikeSongs",
    "Annotator",
    "Cache",
    "CachedArray",
    "Clip",
    "ClipRecord",
    "Clips",
    "DatasetFiles",
    "Engine",
    "Executor",
    "Field",
    "Music",
    "MusicField",
    "Progress",
    "Recipe",
    "RecipeLike",
    "Requirements",
    "Sample",
    "Samples",
    "Scaler",
    "Scene",
    "Seen",
    "SignalId",
    "SourceMusic",
    "SourceRecord",
    "StartFinder",
    "Store",
    "Take",
    "TrainingData",
    "Transform",
    "WindowRule",
    "alike_songs",
    "annotate_clips",
    "audio_length",
    "chosen_recipe",
    "compiling",
    "identify_audio",
    "is_source",
    "jobs_of",
    "load_audio",
    "load_recipe",
    "make_named",
    "music_field",
    "open_store",
    "resample",
    "rewrite_segments",
    "run_units",
    "saved_samples",
    "scan_folder",
    "song_rows",
    "songs_of",
    "sound_field",
    "source_differences",
    "start_workers",
    "stated_tempo",
    "stored_recipe",
    "unit_runner",
]

if TYPE_CHECKING:
    from dancedata.building.arguments import RecipeLike, chosen_recipe, jobs_of
    from dancedata.building.check import scan_folder
    from dancedata.building.clips import annotate_clips
    from dancedata.building.differences import source_differences
    from dancedata.building.fields.music import MusicField
    from dancedata.building.inputs import Music
    from dancedata.building.leaks import AlikeSongs, alike_songs, sound_field
    from dancedata.building.plugins import Annotator, Seen, StartFinder, WindowRule
    from dancedata.building.rewrite import rewrite_segments
    from dancedata.building.signals import SignalId, identify_audio
    from dancedata.building.song_fields import music_field, song_rows, stated_tempo
    from dancedata.building.source_music import SourceMusic, is_source
    from dancedata.building.source_record import SourceRecord
    from dancedata.building.take import Scene, Take, Transform
    from dancedata.execution.cache import Cache, CachedArray
    from dancedata.execution.engines import Engine
    from dancedata.execution.executors import Executor
    from dancedata.execution.progress import Progress
    from dancedata.execution.requirements import Requirements
    from dancedata.execution.units import run_units, start_workers, unit_runner
    from dancedata.music.kernels import compiling
    from dancedata.music.samples import resample
    from dancedata.music.signal import audio_length, load_audio
    from dancedata.recipes.parse import load_recipe, stored_recipe
    from dancedata.recipes.plugins import make_named
    from dancedata.recipes.recipe import Recipe
    from dancedata.samples import Sample, Samples
    from dancedata.samples.saved import saved_samples
    from dancedata.store.clip_columns import CLIP_COLUMNS, ClipRecord
    from dancedata.store.clip_view import Clip, Clips
    from dancedata.store.dataset import Store, open_store
    from dancedata.store.listing import DatasetFiles
    from dancedata.store.normalize import Scaler, TrainingData
    from dancedata.store.schema import DATASET_FILE, Field
    from dancedata.store.songs import songs_of
else:  # type checkers take the imports above, and so find misspelt names
    __getattr__, __dir__ = lazy_names(
        __name__,
        {
            "building.arguments": "RecipeLike chosen_recipe jobs_of",
            "building.check": "scan_folder",
            "building.clips": "annotate_clips",
            "building.differences": "source_differences",
            "building.fields.music": "MusicField",
            "building.inputs": "Music",
            "building.leaks": "AlikeSongs alike_songs sound_field",
            "building.plugins": "Annotator Seen StartFinder WindowRule",
            "building.rewrite": "rewrite_segments",
            "building.signals": "SignalId identify_audio",
            "building.song_fields": "music_field song_rows stated_tempo",
            "building.source_music": "SourceMusic is_source",
            "building.source_record": "SourceRecord",
            "building.take": "Scene Take Transform",
            "execution.cache": "Cache CachedArray",
            "execution.engines": "Engine",
            "execution.executors": "Executor",
            "execution.progress": "Progress",
            "execution.requirements": "Requirements",
            "execution.units": "run_units start_workers unit_runner",
            "music.kernels": "compiling",
            "music.samples": "resample",
            "music.signal": "audio_length load_audio",
            "recipes.parse": "load_recipe stored_recipe",
            "recipes.plugins": "make_named",
            "recipes.recipe": "Recipe",
            "samples": "Sample Samples",
            "samples.saved": "saved_samples",
            "store.clip_columns": "CLIP_COLUMNS ClipRecord",
            "store.clip_view": "Clip Clips",
            "store.dataset": "Store open_store",
            "store.listing": "DatasetFiles",
            "store.normalize": "Scaler TrainingData",
            "store.schema": "DATASET_FILE Field",
            "store.songs": "songs_of",
        },
    )
