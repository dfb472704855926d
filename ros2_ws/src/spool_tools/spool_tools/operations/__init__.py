"""Operations: what the commands do, with libraries that take long to load."""
