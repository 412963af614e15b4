"""Audio: decoding and resampling (`signal`), and the features, one file each."""
