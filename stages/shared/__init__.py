"""What several stages share: the frames of a capture, training views, the model's arrays, one training run."""
