"""`dancedata view`: a dataset in the browser."""
