"""Datasets on hubs, in buckets, on servers: fetched, published."""
