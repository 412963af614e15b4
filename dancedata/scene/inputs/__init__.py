"""Motion from anything: files, folders, clips of datasets, arrays in memory; with the names of its songs."""
