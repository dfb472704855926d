"""Execution: one bag, one task, on the processes of this host or on a Dask cluster."""
