"""Tables: results as Parquet files, and queries over them."""
