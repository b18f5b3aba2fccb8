"""The code that runs in the worker process, which alone imports pycolmap."""
