"""Audio: decoding and resampling (`signal`), and the features, one package each."""
