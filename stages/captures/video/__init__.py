"""What a video file holds: the track to read, the time of every picture, its shape, its colours, and the pictures themselves."""
