"""The public names of the kernel above core and files."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dancedata.core.lazy import lazy_names

__all__ = [
    "ANNOTATORS",
    "CLIP_COLUMNS",
    "DATASET_FILE",
    "RULES",
    "SPLIT_ORDER",
    "TRANSFORMS",
    "Annotator",
    "Cache",
    "Clip",
    "ClipRecord",
    "Clips",
    "Executor",
    "Field",
    "Progress",
    "Reader",
    "Recipe",
    "RecipeLike",
    "Sample",
    "Scaler",
    "Scene",
    "SignalId",
    "SourceMusic",
    "SourceRecord",
    "Store",
    "Take",
    "Transform",
    "WindowRule",
    "as_in_builds",
    "as_numpy",
    "audio_length",
    "check_name",
    "compiling",
    "default_cache",
    "document_differences",
    "document_of",
    "folder_of",
    "identify_audio",
    "is_source",
    "jobs_of",
    "joined_sets",
    "load_audio",
    "load_recipe",
    "local_folder",
    "make_named",
    "network_weights",
    "open_store",
    "optional_fields",
    "pcm16",
    "require_intact",
    "resample",
    "resampled_length",
    "run_units",
    "saved_samples",
    "scan_folder",
    "shaping",
    "slice_length",
    "slice_name",
    "songs_of",
    "source_differences",
    "with_lost_entries",
]

if TYPE_CHECKING:
    from dancedata.building.arguments import RecipeLike, folder_of, jobs_of
    from dancedata.building.check import scan_folder
    from dancedata.building.differences import document_differences, shaping, source_differences
    from dancedata.building.documents import document_of
    from dancedata.building.plugins import ANNOTATORS, RULES, TRANSFORMS, Annotator, WindowRule
    from dancedata.building.signals import SignalId, identify_audio
    from dancedata.building.source_music import SourceMusic, is_source
    from dancedata.building.source_record import SourceRecord
    from dancedata.building.take import Scene, Take, Transform
    from dancedata.execution.addresses import local_folder
    from dancedata.execution.cache import Cache, default_cache, with_lost_entries
    from dancedata.execution.executors import Executor
    from dancedata.execution.progress import Progress
    from dancedata.execution.units import as_in_builds, run_units
    from dancedata.music.kernels import compiling
    from dancedata.music.samples import pcm16, resample, resampled_length
    from dancedata.music.signal import audio_length, load_audio
    from dancedata.recipes.parse import load_recipe
    from dancedata.recipes.plugins import make_named
    from dancedata.recipes.recipe import Recipe
    from dancedata.samples import Sample
    from dancedata.samples.saved import as_numpy, saved_samples
    from dancedata.store.clip_columns import CLIP_COLUMNS, ClipRecord
    from dancedata.store.clip_view import Clip, Clips
    from dancedata.store.dataset import Store, open_store
    from dancedata.store.normalize import Reader, Scaler
    from dancedata.store.queries import network_weights, optional_fields, require_intact, slice_length
    from dancedata.store.schema import DATASET_FILE, SPLIT_ORDER, Field, check_name, slice_name
    from dancedata.store.songs import joined_sets, songs_of
else:  # type checkers take the imports above, and so find misspelt names
    __getattr__, __dir__ = lazy_names(
        __name__,
        {
            "ANNOTATORS": "dancedata.building.plugins",
            "CLIP_COLUMNS": "dancedata.store.clip_columns",
            "DATASET_FILE": "dancedata.store.schema",
            "RULES": "dancedata.building.plugins",
            "SPLIT_ORDER": "dancedata.store.schema",
            "TRANSFORMS": "dancedata.building.plugins",
            "Annotator": "dancedata.building.plugins",
            "Cache": "dancedata.execution.cache",
            "Clip": "dancedata.store.clip_view",
            "ClipRecord": "dancedata.store.clip_columns",
            "Clips": "dancedata.store.clip_view",
            "Executor": "dancedata.execution.executors",
            "Field": "dancedata.store.schema",
            "Progress": "dancedata.execution.progress",
            "Reader": "dancedata.store.normalize",
            "Recipe": "dancedata.recipes.recipe",
            "RecipeLike": "dancedata.building.arguments",
            "Sample": "dancedata.samples",
            "Scaler": "dancedata.store.normalize",
            "Scene": "dancedata.building.take",
            "SignalId": "dancedata.building.signals",
            "SourceMusic": "dancedata.building.source_music",
            "SourceRecord": "dancedata.building.source_record",
            "Store": "dancedata.store.dataset",
            "Take": "dancedata.building.take",
            "Transform": "dancedata.building.take",
            "WindowRule": "dancedata.building.plugins",
            "as_in_builds": "dancedata.execution.units",
            "as_numpy": "dancedata.samples.saved",
            "audio_length": "dancedata.music.signal",
            "check_name": "dancedata.store.schema",
            "compiling": "dancedata.music.kernels",
            "default_cache": "dancedata.execution.cache",
            "document_differences": "dancedata.building.differences",
            "document_of": "dancedata.building.documents",
            "folder_of": "dancedata.building.arguments",
            "identify_audio": "dancedata.building.signals",
            "is_source": "dancedata.building.source_music",
            "jobs_of": "dancedata.building.arguments",
            "joined_sets": "dancedata.store.songs",
            "load_audio": "dancedata.music.signal",
            "load_recipe": "dancedata.recipes.parse",
            "local_folder": "dancedata.execution.addresses",
            "make_named": "dancedata.recipes.plugins",
            "network_weights": "dancedata.store.queries",
            "open_store": "dancedata.store.dataset",
            "optional_fields": "dancedata.store.queries",
            "pcm16": "dancedata.music.samples",
            "require_intact": "dancedata.store.queries",
            "resample": "dancedata.music.samples",
            "resampled_length": "dancedata.music.samples",
            "run_units": "dancedata.execution.units",
            "saved_samples": "dancedata.samples.saved",
            "scan_folder": "dancedata.building.check",
            "shaping": "dancedata.building.differences",
            "slice_length": "dancedata.store.queries",
            "slice_name": "dancedata.store.schema",
            "songs_of": "dancedata.store.songs",
            "source_differences": "dancedata.building.differences",
            "with_lost_entries": "dancedata.execution.cache",
        },
    )
