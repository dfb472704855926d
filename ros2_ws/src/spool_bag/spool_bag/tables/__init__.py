"""Tables: CSV in, CSV and Parquet out."""
