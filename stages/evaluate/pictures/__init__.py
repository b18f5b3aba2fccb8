"""The pictures and movies of an evaluation, for the report."""
