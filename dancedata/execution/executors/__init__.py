"""Engines that run units of work, one module each: this process, worker processes, a Dask cluster."""
