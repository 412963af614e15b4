"""Engines that run units of work, one module each: this process, worker processes, Dask, Ray, joblib."""
