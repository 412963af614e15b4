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
    "make_dataclass",
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
    from dancedata.recipes.plugins import make_dataclass, make_named
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
            "AlikeSongs": "dancedata.building.leaks",
            "Annotator": "dancedata.building.plugins",
            "CLIP_COLUMNS": "dancedata.store.clip_columns",
            "Cache": "dancedata.execution.cache",
            "CachedArray": "dancedata.execution.cache",
            "Clip": "dancedata.store.clip_view",
            "ClipRecord": "dancedata.store.clip_columns",
            "Clips": "dancedata.store.clip_view",
            "DATASET_FILE": "dancedata.store.schema",
            "DatasetFiles": "dancedata.store.listing",
            "Engine": "dancedata.execution.engines",
            "Executor": "dancedata.execution.executors",
            "Field": "dancedata.store.schema",
            "Music": "dancedata.building.inputs",
            "MusicField": "dancedata.building.fields.music",
            "Progress": "dancedata.execution.progress",
            "Recipe": "dancedata.recipes.recipe",
            "RecipeLike": "dancedata.building.arguments",
            "Requirements": "dancedata.execution.requirements",
            "Sample": "dancedata.samples",
            "Samples": "dancedata.samples",
            "Scaler": "dancedata.store.normalize",
            "Scene": "dancedata.building.take",
            "Seen": "dancedata.building.plugins",
            "SignalId": "dancedata.building.signals",
            "SourceMusic": "dancedata.building.source_music",
            "SourceRecord": "dancedata.building.source_record",
            "StartFinder": "dancedata.building.plugins",
            "Store": "dancedata.store.dataset",
            "Take": "dancedata.building.take",
            "TrainingData": "dancedata.store.normalize",
            "Transform": "dancedata.building.take",
            "WindowRule": "dancedata.building.plugins",
            "alike_songs": "dancedata.building.leaks",
            "annotate_clips": "dancedata.building.clips",
            "audio_length": "dancedata.music.signal",
            "chosen_recipe": "dancedata.building.arguments",
            "compiling": "dancedata.music.kernels",
            "identify_audio": "dancedata.building.signals",
            "is_source": "dancedata.building.source_music",
            "jobs_of": "dancedata.building.arguments",
            "load_audio": "dancedata.music.signal",
            "load_recipe": "dancedata.recipes.parse",
            "make_dataclass": "dancedata.recipes.plugins",
            "make_named": "dancedata.recipes.plugins",
            "music_field": "dancedata.building.song_fields",
            "open_store": "dancedata.store.dataset",
            "resample": "dancedata.music.samples",
            "rewrite_segments": "dancedata.building.rewrite",
            "run_units": "dancedata.execution.units",
            "saved_samples": "dancedata.samples.saved",
            "scan_folder": "dancedata.building.check",
            "song_rows": "dancedata.building.song_fields",
            "songs_of": "dancedata.store.songs",
            "sound_field": "dancedata.building.leaks",
            "source_differences": "dancedata.building.differences",
            "start_workers": "dancedata.execution.units",
            "stated_tempo": "dancedata.building.song_fields",
            "stored_recipe": "dancedata.recipes.parse",
            "unit_runner": "dancedata.execution.units",
        },
    )
