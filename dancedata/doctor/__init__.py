"""``dancedata doctor``: whether an installation works, in half a minute and without leaving anything behind."""
