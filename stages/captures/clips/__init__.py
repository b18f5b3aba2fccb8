"""Several video files of one folder: which are cameras, and which are versions or passes of another one."""
