"""Reports: pages, pictures and tables."""
