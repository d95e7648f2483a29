"""Drives of many cars, replayed in chains on Dask distributed."""
