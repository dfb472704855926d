"""Reports: fits judged and ranked, their pages, pictures and tables."""
