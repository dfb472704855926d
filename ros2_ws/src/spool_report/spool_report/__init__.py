"""Records loaded and analysed, and their results as text, JSON, pages and pictures."""
