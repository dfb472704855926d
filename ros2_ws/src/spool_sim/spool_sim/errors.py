from spool_stream.errors import InputError as InputError
