"""The former place of `MinMax`, kept for code that imports it from here: it is in `dancedata.store.normalize`."""

from dancedata.core.lazy import lazy_names

__getattr__, __dir__ = lazy_names(__name__, {"MinMax": "dancedata.store.normalize"})
