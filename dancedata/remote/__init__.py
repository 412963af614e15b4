"""Addresses of datasets on hubs, in buckets and on servers: fetched into the cache, which everything else reads."""
